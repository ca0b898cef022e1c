"""A file that was compressed as a whole (`.mcap.zstd`, rosbag2's compression mode `file`).

An MCAP file is read by leaping about in it, which a compressed one does not allow: it is unpacked
into a temporary file that has no name and is gone with its last reader.
"""

import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO

import zstandard

from koop_bag.errors import BagError
from koop_bag.mcap.stored_file import open_stored

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of a zstd frame (RFC 8878)."""

_BLOCK = 1 << 20
_SHARE = 0.5  # of the free space that an unpacked file may take: others write there as well


def open_unpacked(path: Path) -> BinaryIO:
    """Open a file for reading, unpacked if it is a zstd one.

    A packed file that is torn or damaged reads up to there.

    Raises
    ------
    BagError
        If it cannot be opened, or if there is no room to unpack it.
    """
    try:
        file = open_stored(path)
        if file.read(len(ZSTD_MAGIC)) != ZSTD_MAGIC:
            file.seek(0)
            return file
        with file:
            file.seek(0)
            return _unpack(file, path)
    except OSError as error:
        raise BagError(f"cannot open {path}: {error.strerror}") from error


def _unpack(file: BinaryIO, path: Path) -> BinaryIO:
    room = int(shutil.disk_usage(tempfile.gettempdir()).free * _SHARE)
    target = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the bag
    try:
        source = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while block := source.read(_BLOCK):
            room -= len(block)
            if room < 0:
                raise BagError(
                    f"{path} unpacks to more than half of the space that is free in "
                    f"{tempfile.gettempdir()}: set TMPDIR to a folder on a larger disk"
                )
            target.write(block)
    except zstandard.ZstdError:
        pass  # torn or damaged: what came before is whole
    except BaseException:
        target.close()
        raise
    target.seek(0)
    return target
