"""Which files a bag is made of."""

import re
from collections.abc import Sequence
from pathlib import Path

from koop_bag.bag.metadata import read_description
from koop_bag.errors import BagError, compressed
from koop_bag.mcap.stored_file import reading


def find_files(path: Path) -> list[Path]:
    """Return the MCAP files of a bag in the order in which they were recorded.

    Raises
    ------
    BagError
        If there is none, with what there is instead; if there are files of several bags.
    """
    with reading(path):
        if path.is_file():
            return [path]
        if not path.exists():
            raise BagError(f"there is no bag {path}")
        for folder in (path, path / "bag"):
            for other in folder.glob("*.mcap.*"):
                if not other.with_suffix("").exists():
                    raise compressed(other)
            if files := sorted(folder.glob("*.mcap"), key=_number):
                _refuse_several(files)
                return files
            if any(folder.glob("*.db3*")):
                raise BagError(
                    f"{folder} is an SQLite bag: make it an MCAP one with `ros2 bag convert`"
                )
        raise BagError(f"{path} is not a bag: it contains no .mcap file")


def _refuse_several(files: Sequence[Path]) -> None:
    """Raise BagError if neither names nor the bag's metadata show that files are of one bag."""
    if len({re.sub(r"_\d+$", "", path.stem) for path in files}) == 1:
        return
    folder, names = files[0].parent, [path.name for path in files]
    listed = read_description("", folder).get("relative_file_paths")
    if not (isinstance(listed, list) and set(names) <= set(map(str, listed))):
        few = f"{', '.join(names[:3])}{' and others' * (len(names) > 3)}"
        raise BagError(
            f"{folder} holds {few}: name one of them; if they are of one bag, number them, as in "
            "bag_0.mcap, bag_1.mcap"
        )


def leave_out_empty(files: Sequence[Path]) -> list[Path]:
    """Return the files in which anything was written.

    A machine that loses its power may leave the last file of a recording empty.
    """
    return [path for path in files if not _is_empty(path)]


def _is_empty(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size == 0
    except OSError:
        return False  # a ring dropped it just now; what opens it says so


def _number(path: Path) -> tuple[int, str]:
    """Return the number of a file within its bag, and its name."""
    match = re.search(r"_(\d+)$", path.stem)
    return int(match[1]) if match else 0, path.name
