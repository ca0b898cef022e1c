"""Which files a bag is made of."""

import re
from contextlib import closing, nullcontext, suppress
from itertools import groupby
from pathlib import Path

from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import McapFile
from koop_bag.mcap.stored_file import reading

_NAME = re.compile(r"(.*?(?:_(\d+))?)\.mcap(?:\.zstd?)?")


def find_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in the order in which they were recorded.

    A file that was compressed as a whole (`.mcap.zstd`) is one of them. rosbag2 unpacks one beside
    itself when it plays it, and packs one beside itself when it has recorded it: of the two, the
    whole one counts.

    Raises
    ------
    BagError
        If there is none, with what there is instead.
    """
    with nullcontext() if isinstance(path, Path) else reading(path):
        return _files_of(path)


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.exists():
        raise BagError(f"there is no bag {path}")
    for folder in (path, path / "bag"):
        present = [item for item in folder.glob("*.mcap*") if _NAME.fullmatch(item.name)]
        if present:
            return [
                _whole_one(list(same)) for _, same in groupby(sorted(present, key=_key), key=_key)
            ]
        for other in folder.glob("*.mcap.*"):
            raise BagError(f"{other} is not compressed with zstd, which is what is supported")
        if any(folder.glob("*.db3*")):
            raise BagError(
                f"{folder} is an SQLite bag: make it an MCAP one with `ros2 bag convert`"
            )
    raise BagError(f"{path} is not a bag: it contains no .mcap file")


def _key(path: Path) -> tuple[int, str]:
    """Number of a file within its bag, and its name without the suffixes of compression."""
    match = _NAME.fullmatch(path.name)
    assert match is not None
    return int(match[2] or 0), match[1]


def _whole_one(files: list[Path]) -> Path:
    """The plain file if it is complete, else the packed one."""
    plain, *packed = sorted(files, key=lambda path: len(path.name))
    if packed:
        with suppress(BagError), closing(McapFile(plain)) as file:
            if file.complete:
                return plain
        return packed[0]
    return plain
