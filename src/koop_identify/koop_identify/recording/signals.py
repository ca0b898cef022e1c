"""State, cost and theta of a bag as arrays, of messages that need not be a loop's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_identify.recording.loaded import load_recording
from koop_identify.recording.samples import state_names
from koop_identify.recording.segmentation import BagReading, find_segmentation
from koop_identify.recording.segments import Segmentation


@dataclass(frozen=True)
class Signals:
    """Signals of a recording, one row a state, M in all."""

    names: tuple[str, ...]
    """Names of the n channels."""
    dt: float
    """Time between two states [s]."""
    way: str
    """How messages became states."""
    step: NDArray[np.int64]
    """Shape (M,): step of each state, increasing; of other messages as a lifter that joins counts,
    from 1."""
    t: NDArray[np.float64]
    """Shape (M,): time [s]; of a loop step times dt, else from the first state."""
    begins: NDArray[np.bool_]
    """Shape (M,): whether a state follows on none: the first, and after a gap."""
    measured: NDArray[np.float64]
    ground_truth: NDArray[np.float64]
    """Shape (M, n): x' and, if it was recorded, x; else of shape (M, 0)."""
    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    """Shape (M,): recorded cost and control input; NaN where there is none; theta of n > 1 knobs
    (M, n)."""
    limited: NDArray[np.bool_] | None
    """Shape (M,): whether theta was at a limit; None if the bag does not say."""
    recorded: float
    """Time from the first to the last state, of all runs in the bag [s]."""

    @property
    def has_theta(self) -> bool:
        """Whether theta is known anywhere."""
        return bool(self.theta_known.any())

    @property
    def theta_known(self) -> NDArray[np.bool_]:
        """Where theta of every knob is known, shape (M,)."""
        return np.asarray(np.isfinite(self.theta.reshape(self.t.size, -1)).all(axis=1))

    @property
    def has_r(self) -> bool:
        """Whether a cost was recorded."""
        return bool(np.isfinite(self.r).any())

    @property
    def covered(self) -> float:
        """Time for which there are a state and, if there is any, a theta [s]."""
        usable = self.theta_known if self.has_theta else np.isfinite(self.measured).all(axis=1)
        return float(np.count_nonzero(usable)) * self.dt


def read_signals(path: Path, reading: BagReading, dt: float | None = None) -> Signals:
    """Read the signals of a bag; ``dt`` [s], as of a model, counts where the reading has none.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read or lacks a topic or a field.
    koop_core.errors.InputError
        If there are no states.
    """
    reading = replace(reading, dt=reading.dt or dt)
    with BagReader(path) as bag:
        segmentation, n = find_segmentation(bag, reading)
        loaded = load_recording(bag, reading, segmentation)
    size = loaded.time.size
    return Signals(
        state_names(reading.measured, n),
        segmentation.dt,
        segmentation.way,
        _steps(loaded.time, segmentation),
        loaded.time,
        loaded.begins,
        np.ascontiguousarray(loaded.x.T),
        np.empty((size, 0)),
        np.full(size, np.nan),
        np.full(size, np.nan) if loaded.theta is None else loaded.theta,
        None,
        loaded.recorded + segmentation.dt,
    )


def _steps(time: NDArray[np.float64], segmentation: Segmentation) -> NDArray[np.int64]:
    """Return the steps of states at these times [s]; each state has one of its own."""
    number = np.arange(time.size)
    step = np.round(time / segmentation.dt).astype(np.int64)
    return np.asarray(1 + number + np.maximum.accumulate(step - number))
