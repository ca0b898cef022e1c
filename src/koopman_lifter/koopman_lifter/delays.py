"""Delay embedding: the state is the last samples of the measured channels.

    X_k = [x'_k, x'_{k-s}, ..., x'_{k-(d-1)s}]

The past of one measured channel determines the state of an oscillator of several dimensions (Takens
1981); of the monomials of X_k follows Hankel DMD (Arbabi and Mezic 2017). ``count`` d = 1 is no
embedding: the state is what is measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_core.errors import InputError
from koopman_lifter.settings import LEARNING

ROUNDED = 1e-12  # deviation over the largest value, up to which a channel stands still


@dataclass(frozen=True)
class Delays:
    """Which samples are the state."""

    channels: int
    """Measured channels, at least 1."""
    count: int = 1
    """d, samples of each channel, at least 1."""
    every: int = 1
    """s, sampling times from one of them to the next, at least 1."""

    def __post_init__(self) -> None:
        if min(self.channels, self.count, self.every) < 1:
            raise ValueError(
                f"delays need channels, count and spacing of at least 1, got {self.channels}, "
                f"{self.count}, {self.every}"
            )
        if self.count == 1 and self.every != 1:
            raise ValueError("one sample has no spacing")

    @classmethod
    def spaced(cls, channels: int, count: int, spacing: float, dt: float) -> Delays:
        """Return delays with a spacing and a sampling time [s]; one sample needs no spacing."""
        return cls(channels, count, max(1, round(spacing / dt)) if count > 1 else 1)

    @property
    def n(self) -> int:
        """Dimension of the embedded state."""
        return self.channels * self.count

    @property
    def depth(self) -> int:
        """Consecutive samples that one embedded state spans."""
        return (self.count - 1) * self.every + 1

    def embed(self, states: ArrayLike) -> NDArray[np.float64]:
        """Embed consecutive samples.

        Parameters
        ----------
        states : array_like, shape (channels, M)
            Samples at a uniform step, one a column.

        Returns
        -------
        ndarray, shape (n, M - depth + 1)
            Embedded states, the newest sample first; no column where M < depth.
        """
        array = np.asarray(states, dtype=np.float64)
        if array.ndim != 2 or array.shape[0] != self.channels:
            raise ValueError(
                f"samples must have shape ({self.channels}, M), got {list(array.shape)}"
            )
        if self.count == 1:
            return array
        last = max(array.shape[1] - self.depth + 1, 0)
        newest = self.depth - 1
        return np.vstack(
            [
                array[:, newest - i * self.every : newest - i * self.every + last]
                for i in range(self.count)
            ]
        )

    def names(self, channel_names: tuple[str, ...], dt: float) -> tuple[str, ...]:
        """Return a name for each entry of the embedded state: ``p``, ``p(t-0.1)``, ..."""
        lags = [round(i * self.every * dt, 9) for i in range(self.count)]
        return tuple(
            name if not lag else f"{name}(t-{lag:g})" for lag in lags for name in channel_names
        )


def spacing_for(period: float, count: int) -> float:
    """Return the spacing of ``count`` samples for an oscillation of a period [s]."""
    return LEARNING.span * period / max(count - 1, 1)


def dominant_period(segments: Sequence[NDArray[np.float64]], dt: float) -> float:
    """Return the period [s] of the oscillation whose power varies most.

    Where the power of the channels, in units of their variance, varies most from window to window
    (from the 10 to the 90 % quantile): an interference that is always there does not vary, however
    strong it is. Windows are a twentieth of the data, or as long as the segments of half of it if
    these are shorter; a period of which not two fit into a window is not found.

    Parameters
    ----------
    segments : sequence of ndarray, each of shape (channels, M)
        Consecutive samples.
    dt : float
        Sampling time [s].

    Raises
    ------
    koop_core.errors.InputError
        If there are too few samples, no channel moves, or no power varies.
    """
    sizes = np.sort([segment.shape[1] for segment in segments])[::-1]
    half = sizes[np.searchsorted(np.cumsum(sizes), 0.5 * sizes.sum())] if sizes.size else 0
    length = int(min(half, sizes.sum() // 20))
    unit = units(np.hstack(list(segments)), 1) if segments else np.full(1, math.inf)
    moving = np.isfinite(unit)
    if length < 32 or not moving.any():
        raise InputError(
            f"{sizes.sum():.0f} samples are too few, or do not move: no period is found to choose "
            "the spacing of delays or the length of windows by"
        )
    powers = [window_powers(segment[moving] / unit[moving, None], length) for segment in segments]
    low, high = np.quantile(np.hstack(powers), [0.1, 0.9], axis=1)
    peak = 2 + int(np.argmax((high - low)[2:-1]))
    around = slice(peak - 1, peak + 2)  # the window function spreads a line over three bins
    bins, varied = np.arange(high.size)[around], (high - low)[around]
    if not varied.sum() > 0.0:
        raise InputError(
            "nothing in the samples varies from window to window: no period is found to choose the "
            "spacing of delays or the length of windows by"
        )
    return float(length * dt / np.average(bins, weights=varied))


def units(x: NDArray[np.float64], axis: int | tuple[int, ...]) -> NDArray[np.float64]:
    """Return the standard deviation of each channel; infinite for one that stands still.

    ``axis`` is that of the samples. What rounding makes of a constant is no unit.
    """
    deviation = x.std(axis=axis)
    largest = np.maximum(x.max(axis=axis, initial=0.0), -x.min(axis=axis, initial=0.0))
    return np.where(deviation > ROUNDED * largest, deviation, math.inf)


def window_powers(x: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    """Return the power of consecutive windows, without their lines, shape (length // 2 + 1, T).

    ``x``, shape (channels, M), is weighted by a Hann window; the powers of the channels add up.
    """
    t = np.arange(length) - 0.5 * (length - 1)
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    count = x.shape[1] // length
    windows = x[:, : count * length].reshape(len(x), count, length)
    line = (windows @ t / (t @ t))[..., None] * t + windows.mean(axis=2, keepdims=True)
    return np.asarray((np.abs(np.fft.rfft((windows - line) * hann)) ** 2).sum(axis=0).T)


def embedded_degree(n: int) -> int:
    """Return the largest degree up to the paper's 3 that has few monomials; or 1."""
    return next((degree for degree in (3, 2) if math.comb(n + degree, n) <= LEARNING.monomials), 1)
