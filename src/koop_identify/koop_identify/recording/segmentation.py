"""How a bag becomes states one dt apart, as far as possible from what the bag says itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from koop_bag.bag.reader import BagReader
from koop_core.config.fields import Source
from koop_core.errors import InputError
from koop_identify.recording.counted import mean_period
from koop_identify.recording.recorded_parameters import recorded_values
from koop_identify.recording.samples import Batch, batches
from koop_identify.recording.segments import Segmentation, counted_spacing
from koop_identify.settings import READING


@dataclass(frozen=True)
class BagReading:
    """Which numbers of a bag are measured and commanded, and how they become states."""

    measured: Source
    """Fields that are the state."""
    commands: tuple[Source, ...] = ()
    """Fields that are theta, of each knob; none: the loop's own first where the bag has it."""
    dt: float | None = None
    """Time between two states [s]; None: the recorded loop's, else the messages'."""
    gap: float | None = None
    """Longest pause that is bridged [s]; None: three times the usual period, at least three dt, but
    no missing step. Without stamps, the time in which no sample was taken, however late those
    before came."""

    def __post_init__(self) -> None:
        for name, value in (("dt", self.dt), ("gap", self.gap)):
            if value is not None and not 0.0 < value < 1e6:
                raise InputError(f"{name} = {value:g} s: must be positive")

    @property
    def known_dt(self) -> float:
        """The time between two states [s], once it is known."""
        assert self.dt is not None
        return self.dt


def find_segmentation(bag: BagReader, reading: BagReading) -> tuple[Segmentation, int]:
    """Return how to split a bag into segments, and the number of measured values.

    Raises
    ------
    koop_core.errors.InputError
        If the topic has fewer than two messages, or no time to go by, or dt is far below theirs.
    """
    topic = reading.measured.topic
    first = _first_samples(bag, reading.measured)
    if first is None or first.time.size < 2:
        raise InputError(f"{bag.path}: fewer than two messages on {topic}")
    period = _period(first)
    recorded = recorded_values(bag, topic.rpartition("/")[0] or "/")
    recorded_dt = recorded.get("koopman_lifter", {}).get("dt")
    dt = float(reading.dt or recorded_dt or _sampling_time(first, period))
    if period <= 0.0 and (first.step is None or dt <= 0.0):
        why = (
            f"the stamps of most messages on {topic} do not advance"
            if first.stamped
            else f"messages on {topic} have no stamp and were all received at one time"
        )
        raise InputError(f"{bag.path}: {why}")
    stepped = recorded_dt == dt or abs(_step_time(first) / dt - 1.0) < READING.stepped
    way = "steps" if first.step is not None and stepped else "linear"
    if way == "linear" and period > READING.finer * dt:
        raise InputError(
            f"{bag.path}: dt = {dt:g} s, but a message on {topic} comes every {period:.3g} s only: "
            "between them nothing is known"
        )
    counted = way == "linear" and not first.stamped
    usual = counted_spacing(period, dt) if counted else period
    gap = reading.gap or (dt if way == "steps" else READING.gaps * max(usual, dt))
    segmentation = Segmentation(way, dt, gap, period if counted else 0.0)
    return segmentation, first.x.shape[1]


def _first_samples(bag: BagReader, source: Source) -> Batch | None:
    """Return as many batches in one as tell the period; beside images, one holds few samples."""
    parts: list[Batch] = []
    for batch in batches(bag, source):
        parts.append(batch)
        if sum(part.time.size for part in parts) >= 4 * READING.span:
            break
    if len(parts) < 2:
        return parts[0] if parts else None
    steps = [part.step for part in parts if part.step is not None]
    return Batch(
        np.concatenate([part.time for part in parts]),
        np.concatenate(steps) if steps else None,
        np.vstack([part.x for part in parts]),
        parts[0].stamped,
    )


def _period(batch: Batch) -> float:
    """Return the usual time between two samples [s]."""
    if not batch.stamped:  # they may have come in batches
        return mean_period(batch.time) * 1e-9
    return float(np.median(np.diff(batch.time))) * 1e-9


def _sampling_time(batch: Batch, period: float) -> float:
    """Return dt from the messages themselves [s], without their jitter."""
    step_time = _step_time(batch)
    return float(f"{step_time if np.isfinite(step_time) else period:.3g}")


def _step_time(batch: Batch) -> float:
    """Return the usual time between two steps [s]; NaN if there are none."""
    if batch.step is None:
        return float("nan")
    steps, apart = np.diff(batch.step), np.diff(batch.time)
    return float(np.median(apart[steps == 1])) * 1e-9 if (steps == 1).any() else float("nan")
