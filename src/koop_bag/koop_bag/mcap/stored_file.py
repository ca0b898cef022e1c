"""Files wherever they are stored: on a disk, or in an object store, read by range."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast
from urllib.parse import unquote, urlsplit

from koop_bag.errors import BagError

BLOCK = 4 << 20
"""What is read with one request [B]."""


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
    return open(path, "rb") if isinstance(path, Path) else cast(BinaryIO, RangedFile(path))


@contextmanager
def reading(place: object) -> Iterator[None]:
    """Say what a store has against being read, in one line; each kind has errors of its own."""
    try:
        yield
    except BagError:
        raise
    except ImportError as error:
        raise BagError(f"cannot read {place}: {error} (pip install ...)") from None
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"cannot read {place}: {text}") from error


class Blocks:
    """The blocks of a remote file that were asked for, each once, in a file without a name.

    Attributes
    ----------
    size, requests, read : int
        Bytes of the file, and what was asked for and read.
    """

    def __init__(self, path: Any) -> None:
        from fsspec.caching import MMapCache

        self._path = path
        with reading(path):
            self.size = int(path.stat().st_size)
        self.requests = self.read = 0
        self._cache = MMapCache(BLOCK, self._get, self.size)

    def at(self, start: int, end: int) -> bytes:
        """Return bytes; fewer at the end of the file."""
        return bytes(self._cache._fetch(start, min(end, self.size)))

    def _get(self, start: int, end: int) -> bytes:
        if start >= end:
            return b""
        with reading(self._path):
            data = self._path.fs.cat_file(self._path.path, start=start, end=end)
        self.requests += 1
        self.read += len(data)
        if len(data) != end - start:
            raise BagError(f"cannot read {self._path}: it has changed meanwhile")
        return bytes(data)


_opened: dict[str, Blocks] = {}  # as long as the process: who opens one again asks nothing twice


def traffic() -> list[str]:
    """Return a line for each remote file that was read, with what that took."""
    return [
        f"{url}: {blocks.requests} requests, {blocks.read} of {blocks.size} bytes read"
        for url, blocks in _opened.items()
    ]


class RangedFile(io.RawIOBase):
    """A remote file, of which is read what is asked for."""

    def __init__(self, path: Any) -> None:
        if str(path) not in _opened:
            _opened[str(path)] = Blocks(path)
        self._blocks, self._position = _opened[str(path)], 0

    def readable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a position; where the file ends, nothing is read."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._blocks.size}
        self._position = max(0, base[whence] + offset)
        return self._position

    def readinto(self, buffer: Any, /) -> int:
        """Fill a buffer; return how much of it."""
        data = self._blocks.at(self._position, self._position + len(buffer))
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)
