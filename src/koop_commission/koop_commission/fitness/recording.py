"""Checks a recording of a rig as a live rig is checked; theta is tested where it rested."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import LOG_TIME, list_fields, read_columns
from koop_bag.bag.reader import BagReader
from koop_commission.fitness.fitness import (
    BAD,
    BLIND,
    NOTE,
    Finding,
    choose_period,
    compute_block_features,
    judge_reaction,
    judge_samples,
    name_block_features,
)
from koop_commission.fitness.reaction import STAGES, compare_rests
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS, CheckSettings
from koop_core.config.fields import format_field
from koop_tune.excitation.features import bands, bridged
from koop_tune.rig.rig_file import THETA, RigFile


def check_recording(
    rig: RigFile, bag: Path, settings: CheckSettings = DEFAULTS
) -> Iterator[Finding]:
    """Yield the findings of a bag, or of the run folder that holds it."""
    bag = bag / "bag" if (bag / "bag").is_dir() else bag
    with BagReader(bag) as reader:
        topics = {topic.name for topic in reader.topics if topic.count}
        if rig.state.topic not in topics:
            others = ", ".join(sorted(topics)) or "none"
            text = f"holds no message of {rig.state.topic}; topics with messages: {others}"
            yield Finding(BAD, "bag", text)
            return
        samples = _read_samples(reader, rig)
        theta = _read_theta(reader, rig, topics, samples.arrival)
    yield from judge_samples(rig, samples, measure_pace(samples, rig, settings), settings)
    if theta is None:
        yield Finding(NOTE, "theta", f"is not in the bag: {rig.knob.topic}")
        return
    yield compare_dwell_points(rig, samples, theta, settings)


def _read_samples(reader: BagReader, rig: RigFile) -> Samples:
    stamped = set(list_fields(reader, rig.state.topic)) & {"header.stamp", "step"}
    columns = read_columns(reader, rig.state.topic, [*rig.names, *stamped, LOG_TIME])
    n = columns[LOG_TIME].size
    return Samples(
        columns[LOG_TIME].astype(np.float64) * 1e-9,
        columns.get("header.stamp", np.zeros(n)) * 1e-9,
        columns["step"].astype(np.int64) if "step" in columns else np.full(n, -1),
        np.column_stack([columns[name] for name in rig.names]).astype(np.float64),
    )


def _read_theta(
    reader: BagReader, rig: RigFile, topics: set[str], arrival: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return theta at each arrival, NaN before the first; None if the bag holds none."""
    for topic, field in ((rig.knob.topic, format_field(rig.knob.fields[0])), (THETA, "theta")):
        if topic in topics:
            columns = read_columns(reader, topic, [field, LOG_TIME])
            times = columns[LOG_TIME].astype(np.float64) * 1e-9
            at = np.searchsorted(times, arrival, side="right") - 1
            return np.where(at >= 0, columns[field][np.maximum(at, 0)], np.nan)
    return None


def measure_pace(samples: Samples, rig: RigFile, settings: CheckSettings = DEFAULTS) -> float:
    """Return the seconds of the rig's own time per second of a recording.

    Steps or stamps show it, and a recording may have another pace than the rig file, as one in
    lockstep does; without them it is that of the rig file.
    """
    span = float(samples.arrival[-1] - samples.arrival[0]) or 1.0
    if samples.has_steps:
        pace = float(samples.step[-1] - samples.step[0]) * rig.dt / span
    elif samples.has_stamps:
        pace = float(samples.stamp[-1] - samples.stamp[0]) / span
    else:
        return rig.pace
    return pace if abs(pace / rig.pace - 1.0) > settings.slow else rig.pace


def compare_dwell_points(
    rig: RigFile,
    samples: Samples,
    theta: NDArray[np.float64],
    settings: CheckSettings = DEFAULTS,
) -> Finding:
    """Test whether the measurements differ between rests at low and at high theta, shape (M,)."""
    ends = np.flatnonzero(np.diff(theta, append=np.inf) != 0.0)
    every = [
        (begin, end)
        for begin, end in zip(np.r_[0, ends[:-1] + 1], ends + 1, strict=True)
        if end - begin >= BLIND and math.isfinite(theta[begin])
    ]
    usual = float(np.median([end - begin for begin, end in every])) if every else 0.0
    both = settings.settle + settings.observe
    wanted = both * choose_period(rig, samples) / rig.dt
    least = math.ceil(max(BLIND, min(wanted, settings.shorter * usual)))
    rests = [(begin, end) for begin, end in every if end - begin >= least]
    values = np.array([theta[begin] for begin, _ in rests])
    if len(rests) < STAGES[0][0] or np.ptp(values) == 0.0:
        needed = f"{STAGES[0][0]} rests of {least * rig.dt:.3g} s at two or more values are needed"
        return Finding(NOTE, "theta", f"{len(rests)} rests: {needed} to test whether it acts")
    settle = math.ceil(least * settings.settle / both)
    length = least - settle
    how = bands(bridged(samples.x), length, rig.dt)

    def average(begin: int, end: int) -> NDArray[np.float64]:
        blocks = range(end - (end - begin - settle) // length * length, end, length)
        rows = [compute_block_features(samples.x[at : at + length], how) for at in blocks]
        return np.asarray(np.mean(rows, axis=0))

    reaction = compare_rests(np.array([average(*rest) for rest in rests]), values)
    between = f"theta from {values.min():.4g} to {values.max():.4g}, {len(rests)} rests"
    finding = judge_reaction(reaction, name_block_features(how, rig.names), between)
    if finding.level == BAD:  # the rests were not drawn for this test: it may miss an effect
        text = f"{between}: no effect detected (p = {reaction.p:.2f})"
        return Finding(NOTE, "theta", text)
    return finding
