"""Recordings of a commissioning: room for them, torn ones, and the states that got an answer."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import read_tables
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.errors import BagError, DiskFullError
from koop_core.errors import LiveError
from koop_tune.rig.rig_file import STATE, THETA, RigFile

BYTES = 250.0  # of a bag for one state, with its cost and theta


def refuse_small_disk(rig: RigFile, folder: Path, seconds: float) -> None:
    """Refuse a disk that has no room for a recording of some time [s].

    Raises
    ------
    koop_core.errors.LiveError
        If it has none.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    needed = BYTES * max(seconds, 0.0) / rig.dt
    if free < needed:
        raise LiveError(
            f"{existing}: {free / 1e6:.0f} MB are free, up to {needed / 1e6:.0f} MB are needed: "
            "make room, or set a shorter 'time' in the rig file"
        )


def recover_torn(bag: Path) -> None:
    """Make a torn bag readable, as a full disk or a kill leaves one.

    The torn one stays beside it if some of it could not be read.

    Raises
    ------
    koop_core.errors.LiveError
        If there is no room for that.
    """
    whole, torn = bag.with_name("bag-whole"), bag.with_name("bag-torn")
    shutil.rmtree(whole, ignore_errors=True)  # of a recovery that was interrupted itself
    if torn.exists() and not bag.exists():
        torn.rename(bag)
    try:
        with BagReader(bag) as reader:
            if reader.complete:
                return
        recovered = recover(bag, whole)
    except DiskFullError:
        shutil.rmtree(whole, ignore_errors=True)
        raise LiveError(f"{bag} is torn, and there is no room to recover it: make room") from None
    except BagError:
        return  # of a recorder that never received a message
    bag.rename(torn)
    whole.rename(bag)
    rest = f"; what could not be read is in {torn.name}" if recovered.damaged_records else ""
    if not rest:
        shutil.rmtree(torn)
    print(f"{bag} was torn: recovered {recovered.messages} messages{rest}")


def count_answers(bag: Path) -> tuple[int, int]:
    """Return how many states a bag holds, and for how many of them a theta."""
    with BagReader(bag) as reader:
        topics = {topic.name for topic in reader.topics if topic.count}
        if not topics >= {STATE, THETA}:
            return 0, 0
        tables = read_tables(reader, {STATE: ["step"], THETA: ["step"]})
    states, thetas = (np.unique(tables[topic]["step"]) for topic in (STATE, THETA))
    return states.size, np.intersect1d(states, thetas).size
