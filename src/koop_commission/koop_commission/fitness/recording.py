"""Checks a recording of a rig as a live rig is checked, but for the reaction to theta."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import LOG_TIME, list_fields, read_columns
from koop_bag.bag.reader import BagReader
from koop_commission.fitness.fitness import BAD, Finding, judge_samples
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS
from koop_tune.rig.rig_file import RigFile


def check_recording(rig: RigFile, bag: Path) -> Iterator[Finding]:
    """Yield the findings of a bag, or of the run folder that holds it.

    Whether theta acts, 'koop tune' tells from the static map.
    """
    bag = bag / "bag" if (bag / "bag").is_dir() else bag
    with BagReader(bag) as reader:
        topics = {topic.name for topic in reader.topics if topic.count}
        if rig.measured_source.topic not in topics:
            others = ", ".join(sorted(topics)) or "none"
            text = (
                f"holds no message of {rig.measured_source.topic}; topics with messages: {others}"
            )
            yield Finding(BAD, "bag", text)
            return
        stamped = set(list_fields(reader, rig.measured_source.topic)) & {"header.stamp", "step"}
        columns = read_columns(reader, rig.measured_source.topic, [*rig.names, *stamped, LOG_TIME])
    n = columns[LOG_TIME].size
    samples = Samples(
        columns[LOG_TIME].astype(np.float64) * 1e-9,
        columns.get("header.stamp", np.zeros(n)) * 1e-9,
        columns["step"].astype(np.int64) if "step" in columns else np.full(n, -1),
        np.column_stack([columns[name] for name in rig.names]).astype(np.float64),
    )
    yield from judge_samples(rig, samples, measure_pace(samples, rig))


def measure_pace(samples: Samples, rig: RigFile) -> float:
    """Return the seconds of the rig's own time per second of a recording.

    Steps or stamps show it, and a recording may have another pace than the rig file, as one in
    lockstep does; without them it is the rig file's.
    """
    span = float(samples.arrival[-1] - samples.arrival[0]) or 1.0
    if samples.has_steps:
        pace = float(samples.step[-1] - samples.step[0]) * rig.dt / span
    elif samples.has_stamps:
        pace = float(samples.stamp[-1] - samples.stamp[0]) / span
    else:
        return rig.pace
    return pace if abs(pace / rig.pace - 1.0) > DEFAULTS.slow else rig.pace
