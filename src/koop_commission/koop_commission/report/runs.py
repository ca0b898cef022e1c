"""A recorded closed loop: theta and amplitude over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_identify.recording.loaded import list_segments
from koop_identify.recording.loop import read_loop
from koop_loop.thinning import thin
from koop_tune.excitation.amplitude import Amplitude

POINTS = 400  # of a curve; theta has twice as many


class RunCurves(NamedTuple):
    """A closed loop.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Time since the loop was closed [s].
    theta : list of ndarray, shape (K,)
        Theta of each knob then: extremes of neighbouring samples.
    middle, amplitude : ndarray, shape (L,)
        Middle of each window [s], and the amplitude in it.
    """

    time: NDArray[np.float64]
    theta: list[NDArray[np.float64]]
    middle: NDArray[np.float64]
    amplitude: NDArray[np.float64]


def read_run(bag: Path, amplitude: Amplitude, steps: Sequence[int]) -> RunCurves:
    """Read a recording; ``steps`` are the first and last with the loop closed.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    koop_core.errors.InputError
        If it holds no theta.
    """
    signals = read_loop(bag, dt=amplitude.windows.dt)
    closed = (signals.step >= steps[0]) & (signals.step <= steps[1])
    controlled = closed & signals.theta_known
    if not controlled.any():
        raise InputError(f"{bag}: holds no theta")
    t = signals.t - signals.t[controlled][0]
    (length, dt), middles, amplitudes = amplitude.windows, [], []
    for segment in list_segments(signals.begins):
        for first in range(segment.start, segment.stop - length + 1, length):
            window = slice(first, first + length)
            x = signals.measured[window]
            if closed[window].all() and np.isfinite(x).any(axis=0).all():
                middles.append(float(t[first]) + 0.5 * length * dt)
                amplitudes.append(float(np.exp(amplitude.logs(x)[0])))
    every = max(-(-len(middles) // POINTS), 1)
    return RunCurves(
        thin(t[controlled], t[controlled], POINTS)[0],
        [
            thin(t[controlled], path, POINTS)[1]
            for path in np.atleast_2d(signals.theta[controlled].T)
        ],
        np.array(middles[::every]),
        np.array(amplitudes[::every]),
    )
