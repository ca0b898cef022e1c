"""Errors of bags. Each message says what happened and how to mend it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from koop_core.errors import KoopError


class BagError(KoopError):
    """A bag that is absent, foreign or damaged, or a request that it cannot answer."""


class BagWriteError(BagError):
    """A bag could not be written on; what was written before stays readable."""


@contextmanager
def writing(action: str) -> Iterator[None]:
    """Turn a failure of the disk into a BagWriteError that says what could not be done."""
    try:
        yield
    except OSError as error:
        raise BagWriteError(f"cannot {action}: {error.strerror}") from error


def compressed(path: Path) -> BagError:
    """Return the error of a bag that rosbag2 compressed by message or by file."""
    return BagError(
        f"{path} was compressed by rosbag2, by message or by file: unpack it with "
        "`ros2 bag convert` (MCAP's own compression of chunks is read)"
    )
