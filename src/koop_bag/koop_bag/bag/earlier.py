"""The rings that earlier runs of a loop have left in folders beside this run's."""

import fcntl
import glob
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from koop_bag.bag.files import find_files
from koop_bag.errors import BagError, writing

ALARMS = "alarms"
"""Folder in a ring for the files around alarms: at most half of what the ring may take."""
NAMED = "alarms.txt"
"""Names of a ring's files around alarms, which it has not moved there yet."""
_RUN = re.compile(r"\d{8}T\d{6}Z-(.+)")  # of a run's folder


def lock(bag: Path) -> int | None:
    """Lock a bag until the descriptor is closed; None where another process has, or none can."""
    with suppress(OSError):
        descriptor = os.open(bag, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except OSError:
            os.close(descriptor)
    return None


def name_of_alarm(bag: Path, names: Iterable[str]) -> None:
    """Name files of a ring as of an alarm."""
    with suppress(OSError), open(bag / NAMED, "a") as file:
        file.write(" ".join([*names, ""]))


def name_newest(bag: Path) -> None:
    """Name the two newest files of a ring whose recorder was killed, as of an alarm."""
    with suppress(BagError, OSError):
        name_of_alarm(bag, [file.name for file in find_files(bag)[-2:]])


class EarlierRuns:
    """Files that a ring may drop before its own: of rings that have ended, the oldest first.

    ``runs`` are their folders. What is of an alarm stays; ``kept`` are its bytes.
    """

    def __init__(self, runs: Iterable[Path] = ()) -> None:
        self.files: list[Path] = []
        self.size = self.kept = 0
        for bag in (run / "bag" for run in runs):
            self.kept += _bytes_of(bag.glob(f"{ALARMS}/*.mcap"))
            if (descriptor := lock(bag)) is None:
                continue
            os.close(descriptor)
            with suppress(BagError, OSError):
                files, named = find_files(bag), bag / NAMED
                of_alarm = named.read_text().split() if named.exists() else []
                self.files += [file for file in files if file.name not in of_alarm]
                self.kept += _bytes_of(file for file in files if file.name in of_alarm)
        self.size = _bytes_of(self.files)

    def end(self) -> int:
        """Return when the oldest file was last written to [ns since the epoch]."""
        with suppress(OSError):
            return self.files[0].stat().st_mtime_ns
        return 0

    def drop(self) -> int:
        """Remove the oldest file; return the bytes that become free."""
        path = self.files.pop(0)
        size = _bytes_of([path])
        with writing(f"drop {path}"):
            # it does not say what is there now; `koop bag recover` makes it again
            path.with_name("metadata.yaml").unlink(missing_ok=True)
            path.unlink(missing_ok=True)
        self.size -= size
        return size


def label_of(folder: Path) -> str:
    """Return the label in the name of a run's folder; empty if it is not named after a time."""
    match = _RUN.fullmatch(folder.name)
    return match[1] if match else ""


def find_earlier(folder: Path) -> list[Path]:
    """Return the folders of earlier runs with a ring and this one's label, the oldest first."""
    label = label_of(folder)
    return sorted(
        run
        for run in folder.parent.glob(f"*Z-{glob.escape(label)}")
        if label and label_of(run) == label
        and run.name < folder.name and (run / "summary").is_dir()
    )  # fmt: skip


def _bytes_of(files: Iterable[Path]) -> int:
    total = 0
    for file in files:
        with suppress(OSError):  # a user may have made room
            total += file.stat().st_size
    return total
