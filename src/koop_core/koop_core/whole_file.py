"""Files that are whole at any time: written beside the old one, which they then replace."""

from __future__ import annotations

import errno
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from koop_core.config.objects import parse, to_json
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError

T = TypeVar("T")
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_json(path: Path, values: Any) -> None:
    """Write a JSON file, also of a dataclass; as :func:`write_text`."""
    write_text(path, json.dumps(to_json(values), indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file; as :func:`write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file that is whole at any time, also if the machine fails.

    Raises
    ------
    koop_core.errors.LiveError
        If it cannot be written, as on a full disk; the old one stays.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with open(new, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as error:
        raise LiveError(describe_failure(path, error)) from None
    finally:
        with suppress(OSError):
            new.unlink(missing_ok=True)


def describe_failure(path: Path, error: OSError) -> str:
    """Return why a file or a folder cannot be written, and what to do, in words."""
    room = ": make room" if error.errno in FULL else ""
    return f"{path}: {error.strerror or error}{room}"


def read_json(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds; nothing if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be read.
    """
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}: delete or replace it") from None


def read_object(path: Path, kind: type[T]) -> T | None:
    """Return the object that a JSON file describes; None if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be read.
    """
    values = read_json(path)
    try:
        return parse(kind, values, path.name) if values else None
    except ConfigError as error:
        raise ConfigError(f"{path}: cannot be read ({error}): move it away") from None
