"""The closed loop as it was recorded: theta and amplitude over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.loaded import pieces
from koop_identify.recording.signals import Signals, loop_signals
from koop_loop.thinning import extremes
from koop_tune.excitation.features import Bands, features

POINTS = 400  # of a curve, twice as many of theta's


@dataclass(frozen=True)
class Measured:
    """A recorded run.

    Attributes
    ----------
    time, theta : ndarray, shape (K,)
        Theta over time [s], from when the loop is closed; extremes of neighbouring samples.
    at, amplitude : ndarray, shape (L,)
        Middle of each window [s], and the amplitude there.
    """

    time: NDArray[np.float64]
    theta: NDArray[np.float64]
    at: NDArray[np.float64]
    amplitude: NDArray[np.float64]


def measured(
    bag: Path, dt: float, how: Bands, feature: int, steps: Sequence[int] | None = None
) -> Measured:
    """Read a run.

    Parameters
    ----------
    bag : Path
        The recording of a loop.
    dt : float
        Time between two states [s].
    how : Bands
        How its windows are looked at.
    feature : int
        Which amplitude counts.
    steps : sequence of int, optional
        The first and the last one with the loop closed; by default those that have a theta.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    ValueError
        If it holds no theta.
    """
    _, signals = loop_signals(bag, "/", dt)
    known = np.isfinite(signals.theta)
    if steps is not None:
        known &= (signals.step >= steps[0]) & (signals.step <= steps[1])
    if not known.any():
        raise ValueError(f"{bag}: holds no theta")
    begin, end = (float(signals.t[known][k]) for k in (0, -1))
    time, theta = _thinned(signals.t[known] - begin, signals.theta[known])
    at, amplitude = _amplitudes(signals, begin, end, how, feature)
    return Measured(time, theta, at, amplitude)


def _thinned(
    t: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a signal as least and largest of each block, one after the other."""
    block = -(-t.size // POINTS)
    if block == 1:
        return t, values
    low, high = extremes(values, block)
    begins = t[::block][: low.size]
    middles = t[block // 2 :: block][: low.size]
    return (
        np.stack([begins, middles], axis=1).ravel(),
        np.stack([low, high], axis=1).ravel(),
    )


def _amplitudes(
    signals: Signals, begin: float, end: float, how: Bands, feature: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the amplitude in windows, one after the other, of what has no gap."""
    at, found = [], []
    for piece in pieces(signals.begins):
        for first in range(piece.start, piece.stop - how.length + 1, how.length):
            if signals.t[first] < begin or signals.t[first] + how.length * how.dt > end + how.dt:
                continue
            x = signals.x[first : first + how.length]
            if np.isfinite(x).any(axis=0).all():
                at.append(float(signals.t[first]) - begin + 0.5 * how.length * how.dt)
                found.append(float(np.exp(features(x, how)[feature])))
    every = -(-len(at) // POINTS) if at else 1
    return np.array(at[::every]), np.array(found[::every])
