"""What the windows at one value of theta say: when the rig has settled, its level and the error.

At each value the amplitude is taken in one window after the other; the level is the logarithm of
its root mean square. What comes before the rig has settled is left out: the d windows for which the
marginal standard error of the rest is least (White, Simulation 69 (1997) 323-334),

    d = argmin_{d <= m/2} var(a_d .. a_m) / (m - d)

and as long as d is at that end, the rig is still settling. The standard error of the rest counts
that neighbouring windows are alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Visit:
    """One rest of theta at one of its values.

    Attributes
    ----------
    level : int
        Number of the value.
    mean, error : tuple of float
        Level of each feature, after the rig had settled; its standard error.
    settled : float
        Time that the rig needed to settle [s].
    stay : float
        Time that theta rested [s].
    """

    level: int
    mean: tuple[float, ...]
    error: tuple[float, ...]
    settled: float
    stay: float


class WindowSummary(NamedTuple):
    """What the windows at one value say so far.

    Attributes
    ----------
    skip : int
        Windows that are left out: the rig was settling.
    settled : bool
        Whether that is over.
    mean, error : ndarray, shape (f,)
        Level of each feature and its standard error.
    """

    skip: int
    settled: bool
    mean: NDArray[np.float64]
    error: NDArray[np.float64]


def summarise(series: NDArray[np.float64], guides: Sequence[int]) -> WindowSummary:
    """Summarise the windows at one value.

    Parameters
    ----------
    series : ndarray, shape (m, f)
        Features of each window, m at least 2.
    guides : sequence of int
        Features that tell when the rig has settled.
    """
    most = series.shape[0] // 2
    skip = max(int(np.argmin(_marginal_error(series[:, j], most))) for j in guides)
    return WindowSummary(skip, skip < most, *mean_level(series[skip:]))


def _marginal_error(values: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Return var(a_d .. a_m) / (m - d) for d up to ``most``."""
    backwards = values[::-1] - values.mean()
    count = np.arange(1, values.size + 1)
    mean = np.cumsum(backwards) / count
    variance = np.maximum(np.cumsum(backwards**2) / count - mean**2, 0.0)
    return np.asarray((variance / count)[::-1][: most + 1])


def mean_level(logs: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the logarithm of the root mean square of each column's exponential, and its error.

    The mean of the logarithm would be lower the more an amplitude comes and goes in a window, and
    less sure: by a third for the one of a noise-driven oscillation.
    """
    top = logs.max(axis=0)
    power = np.exp(2.0 * (logs - top))
    mean = power.mean(axis=0)
    return top + 0.5 * np.log(mean), 0.5 * standard_error(power) / mean


def standard_error(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard error of the mean of each column; neighbours may be alike.

    se^2 = var s / (m - s),   s of :func:`count_alike`
    """
    m = values.shape[0]
    if m < 3:
        return np.full(values.shape[1], math.inf)
    count = count_alike(values)
    return np.asarray(np.sqrt(values.var(axis=0) * count / (m - count)))


def count_alike(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how many neighbouring windows of each column know no more than one.

        s = 1 + 2 sum_k rho_k

    The sum of the autocorrelation ends where two neighbours of it are no longer positive together
    (Geyer, Statistical Science 7 (1992) 473-483), and s is at most a third of the windows.
    """
    m = values.shape[0]
    centred = values - values.mean(axis=0)
    size = 1 << (2 * m - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    rho = np.fft.irfft(spectrum, size, axis=0)[: m // 2 + 1]
    power = np.maximum((centred**2).sum(axis=0), 1e-300)
    pairs = rho[: rho.shape[0] // 2 * 2].reshape(-1, 2, values.shape[1]).sum(axis=1) / power
    positive = np.cumprod(pairs > 0.0, axis=0)  # up to the first that is not
    return np.asarray(np.clip(2.0 * (pairs * positive).sum(axis=0) - 1.0, 1.0, m / 3.0))
