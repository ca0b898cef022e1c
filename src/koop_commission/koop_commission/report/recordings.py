"""Every recording of a commissioning: duration, losses, and whether it was closed."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import read_tables
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_commission.report.contents import Contents
from koop_tune.rig.rig_file import STATE, THETA
from koop_view.report.document import Cell, Column, Section, Table

COLUMNS = (
    Column("recording", "recording"),
    Column("begun", "begun (UTC)"),
    Column("duration", "duration, of the rig's time [s]", ".0f"),
    Column("states", "states", "d"),
    Column("lost", "lost", "d"),
    Column("without_theta", "without theta", "d"),
    Column("size", "MB", ".1f"),
    Column("whole", "closed", words=True),
)
INTRO = "States recorded before the first command and after the last one have no theta."


def make_recordings(c: Contents) -> Section:
    """Return all recordings, in the order in which they were made."""
    bags = [f"{part}/bag" for part in c.excitation.parts]
    bags += [run.bag for item in c.verification.rounds for run in item.runs]
    rows = [(bag, *describe_bag(c.folder / bag, c.rig.dt)) for bag in bags]
    table = Table("recordings", "All recordings", COLUMNS, rows)
    return Section("recordings", "Recordings", INTRO, tables=[table])


def describe_bag(bag: Path, dt: float) -> tuple[Cell, ...]:
    """Return the row of a bag, without its name."""
    try:
        with BagReader(bag) as reader:
            begun = datetime.fromtimestamp(reader.start_time * 1e-9, timezone.utc)
            topics = {topic.name for topic in reader.topics if topic.count} & {STATE, THETA}
            tables = read_tables(reader, {topic: ["step"] for topic in topics})
            size, closed = reader.size / 1e6, "yes" if reader.complete else "NO"
    except BagError as error:
        return None, None, None, None, None, None, f"cannot be read: {error}"
    steps = {topic: table["step"].astype(np.int64) for topic, table in tables.items()}
    states = steps.get(STATE, np.empty(0, np.int64))
    missing = int(np.setdiff1d(states, steps[THETA]).size) if THETA in steps else None
    lost = count_losses(states).lost
    duration = float(states.size + lost) * dt
    return f"{begun:%Y-%m-%d %H:%M:%S}", duration, states.size, lost, missing, size, closed
