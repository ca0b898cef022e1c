"""Files wherever they are stored: on a disk, or in an object store, read by range."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, cast
from urllib.parse import unquote, urlsplit

from koop_bag.errors import BagError

BLOCK = 4 << 20
"""Bytes that are read with one request."""


def stored_path(place: str | Path) -> Path:
    """Return the path of a file or folder; of a URL, one with pathlib's methods.

    Raises
    ------
    BagError
        If the URL's kind is unknown, or what reads it is not installed.
    """
    if not isinstance(place, str) or "://" not in place:
        return place if not isinstance(place, str) else Path(place)
    if place.startswith("file://"):
        return Path(unquote(urlsplit(place).path))
    try:
        from upath import UPath
    except ImportError as error:
        raise BagError(
            f"cannot read {place} ({error}): pip install universal-pathlib fsspec"
        ) from None
    with reading(place):
        path = UPath(place)
        _ = path.fs  # loads what knows this kind of store
    return cast(Path, path)


def open_stored(path: Path) -> BinaryIO:
    """Open a file for reading.

    Raises
    ------
    OSError
        If there is none on the disk.
    BagError
        If there is none in the store, or the store does not answer.
    """
    if isinstance(path, Path):
        return open(path, "rb")
    with reading(path):
        return cast(BinaryIO, _with_cache(path.fs).open(path.path, "rb", block_size=BLOCK))


@contextmanager
def reading(place: object) -> Iterator[None]:
    """Turn the errors of a store, which each kind has of its own, into a BagError of one line."""
    try:
        yield
    except BagError:
        raise
    except ImportError as error:
        raise BagError(f"cannot read {place}: {error} (pip install ...)") from None
    except Exception as error:
        if isinstance(place, Path):  # on the disk
            raise
        text = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"cannot read {place}: {text}") from error


@cache
def _with_cache(store: Any) -> Any:
    """Return a store that keeps the blocks it has read on the disk until the process ends."""
    from fsspec.implementations.cached import CachingFileSystem

    return CachingFileSystem(fs=store, cache_storage="TMP")
