"""Every recording of a commissioning: how long, and whether anything is missing."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import read_tables
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_commission.report.gathered import Gathered
from koop_tune.rig.rig_file import STATE, THETA
from koop_view.report.document import Cell, Column, Table

COLUMNS = (
    Column("recording", "recording"),
    Column("begun", "begun (UTC)"),
    Column("duration", "of the rig [s]", ".0f"),
    Column("states", "states", "d"),
    Column("lost", "lost", "d"),
    Column("without_theta", "without theta", "d"),
    Column("size", "MB", ".1f"),
    Column("whole", "closed in order", words=True),
)


def table(g: Gathered) -> Table:
    """Return all recordings, in the order of their making."""
    named = [folder / "bag" for folder in (g.folder / part for part in g.excited.parts)]
    named += [g.folder / run["bag"] for one in g.rounds for run in one["runs"]]
    rows = [_row(bag, g.folder, g.rig.dt) for bag in named]
    return Table("recordings", "All recordings", COLUMNS, rows)


def _row(bag: Path, folder: Path, dt: float) -> tuple[Cell, ...]:
    name = str(bag.relative_to(folder)) if bag.is_relative_to(folder) else str(bag)
    try:
        with BagReader(bag) as reader:
            begun = datetime.fromtimestamp(reader.start_time * 1e-9, timezone.utc)
            counted = {topic.name for topic in reader.topics if topic.count}
            wanted = {topic: ["step"] for topic in (STATE, THETA) if topic in counted}
            tables = read_tables(reader, wanted)
            size, whole = reader.size / 1e6, "yes" if reader.complete else "NO"
    except BagError as error:
        return name, None, None, None, None, None, None, f"cannot be read: {error}"
    steps = {topic: found["step"].astype(np.int64) for topic, found in tables.items()}
    states = steps.get(STATE, np.empty(0, np.int64))
    missing = None
    if THETA in steps:
        missing = int(np.setdiff1d(states, steps[THETA]).size)
    lost = count_losses(states).lost
    return (
        name, f"{begun:%Y-%m-%d %H:%M:%S}", float(states.size + lost) * dt, int(states.size),
        lost, missing, size, whole,
    )  # fmt: skip
