"""Delay embedding: the state is the last samples of the measured channels.

    X_k = [x'_k, x'_{k-s}, ..., x'_{k-(d-1)s}]

One measured channel tells the state of an oscillator of several dimensions by its past (Takens
1981); of the monomials of X_k follows Hankel DMD (Arbabi and Mezic 2017). ``count`` d = 1 is no
embedding: the state is what is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPAN = 0.125  # of the dominant period, from the newest to the oldest sample


@dataclass(frozen=True)
class Delays:
    """Which samples are the state.

    Attributes
    ----------
    channels : int
        Measured channels, at least 1.
    count : int
        d, samples of each channel, at least 1.
    every : int
        s, sampling times from one of them to the next, at least 1.
    """

    channels: int
    count: int = 1
    every: int = 1

    def __post_init__(self) -> None:
        if min(self.channels, self.count, self.every) < 1:
            raise ValueError(
                f"delays need channels, count and spacing of at least 1, got {self.channels}, "
                f"{self.count}, {self.every}"
            )
        if self.count == 1 and self.every != 1:
            raise ValueError("one sample has no spacing")

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


def spacing(span: float, count: int, dt: float) -> int:
    """Return the sampling times between ``count`` samples that are to span ``span`` [s]."""
    return max(1, round(span / dt / max(count - 1, 1)))


def dominant_period(states: NDArray[np.float64], dt: float) -> float:
    """Return the period [s] in which the channels oscillate most.

    The highest peak of the spectra (Welch's method, channels of unit variance, a segment of a
    quarter of the data), refined by nothing: within a frequency bin it is as good as any for
    choosing a spacing.

    Parameters
    ----------
    states : ndarray, shape (channels, M)
        Consecutive samples; some ten periods or more.
    dt : float
        Sampling time [s].

    Raises
    ------
    ValueError
        If there are fewer than 64 samples, or no channel moves.
    """
    from scipy.signal import welch  # slow to import, and only training asks

    size = states.shape[1]
    deviation = states.std(axis=1)
    if size < 64 or not (deviation > 0.0).any():
        raise ValueError("too few samples that move to choose a spacing: give --spacing")
    moving = states[deviation > 0.0] / deviation[deviation > 0.0, None]
    frequency, power = welch(moving, fs=1.0 / dt, nperseg=max(64, size // 4))
    return float(1.0 / frequency[1 + int(np.argmax(power.sum(axis=0)[1:]))])


def embedded_degree(n: int, most: int = 120) -> int:
    """Return the largest degree up to the paper's 3 that has at most ``most`` monomials; or 1."""
    return next((degree for degree in (3, 2) if math.comb(n + degree, n) <= most), 1)
