"""Errors of bags. Each message says what happened and how to mend it."""

from pathlib import Path

from koop_core.errors import KoopError


class BagError(KoopError):
    """A bag that is absent, foreign or damaged, or a request that it cannot answer."""


class BagWriteError(BagError):
    """A bag could not be written on; what was written before stays readable."""


def compressed(path: Path) -> BagError:
    """Return the error of a bag that rosbag2 compressed by message or by file."""
    return BagError(
        f"{path} was compressed by rosbag2, by message or by file: unpack it with "
        "`ros2 bag convert` (MCAP's own compression of chunks is read)"
    )
