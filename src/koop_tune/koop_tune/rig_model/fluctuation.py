"""Spontaneous fluctuation of a noise-driven oscillation.

Such an oscillation has the amplitude of a complex Ornstein-Uhlenbeck process: where theta
rests, the autocovariance of its power p = |z|^2 over the mean is

    cov(p(t), p(t + s)) = share exp(-2 s / tau) + const

with the time constant tau with which the amplitude follows theta, too. White noise of a window
adds to it at s = 0 only, a level that drifts from rest to rest the constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, parameter
from koop_tune.origin import studied
from koop_tune.rig_model.dwells import Dwells


@dataclass(frozen=True)
class FluctuationSettings(Settings):
    """How the autocovariance is fitted."""

    shortest: float = studied(0.3, "shortest decay", unit="windows", low=0.1)
    longest: float = studied(0.1, "longest decay, over the longest rest", low=0.0, high=1.0)
    count: int = parameter(60, "decays that are tried", low=2)
    as_good: float = studied(1.02, "misfit over the least of the shortest that fits", low=1.0)
    least: float = studied(0.4, "share of the variance that lasts: a drift is less", low=0.0)
    wanders: float = studied(0.1, "share of the power from which noise drives it", low=0.0)
    lags: float = studied(0.5, "lags that are fitted, over the longest rest", low=0.0, high=1.0)


FLUCTUATION = FluctuationSettings()


class Fluctuation(NamedTuple):
    """Time constant and strength of the fluctuation.

    Attributes
    ----------
    time : float
        Time constant tau of the amplitude [s]; one window if nothing that lasts was seen.
    share : float
        Variance of the power over the square of its mean; 1 of an oscillation that noise alone
        drives, seen in windows much shorter than tau.
    """

    time: float
    share: float


def fit_fluctuation(dwells: Dwells) -> Fluctuation:
    """Fit the autocovariance of the power in the windows of all rests once the rig had settled."""
    s, parts = FLUCTUATION, relative_power(dwells)
    longest = max(part.size for part in parts)
    lags = max(int(s.lags * longest), 3)
    fit, count = estimate_autocovariance(parts, lags)
    k, y, w = np.arange(1, lags), fit[1:], count[1:]
    decays = np.geomspace(s.shortest, max(s.longest * longest, 2.0 * s.shortest), s.count)
    least = s.least * float(fit[0])
    misfits = np.array([_misfit(k, y, w, float(decay), least) for decay in decays])
    windows = 1.0
    if np.isfinite(misfits).any():
        windows = 2.0 * float(decays[int(np.argmax(misfits <= s.as_good * misfits.min()))])
    return Fluctuation(windows * dwells.amplitude.windows.seconds, float(fit[0]))


def _misfit(
    k: NDArray[np.int64], y: NDArray[np.float64], w: NDArray[np.float64], decay: float, least: float
) -> float:
    """Return how far points are from the nearest share exp(-k / decay) + const, least < share."""
    e = np.exp(-k / decay)
    terms = np.stack([e, np.ones(k.size)], axis=1) * np.sqrt(w)[:, None]
    (share, const), *_ = np.linalg.lstsq(terms, y * np.sqrt(w))
    return float((w * (y - share * e - const) ** 2).sum()) if share > least else math.inf


def relative_power(dwells: Dwells) -> list[NDArray[np.float64]]:
    """Return the power in the windows of each rest over the mean one at its theta, less 1."""
    settled = dwells.settled(dwells.logs)
    top = max(float(values.max()) for values in settled)
    power = [np.exp(2.0 * (values - top)) for values in settled]
    levels = np.array([rest.level for rest in dwells.rests])
    mean = {
        level: float(np.concatenate([power[i] for i in np.flatnonzero(levels == level)]).mean())
        for level in np.unique(levels)
    }
    return [p / max(mean[level], 1e-300) - 1.0 for p, level in zip(power, levels, strict=True)]


def estimate_autocovariance(
    parts: list[NDArray[np.float64]], lags: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the autocovariance of segments about zero at 0 .. lags - 1, and of how many pairs."""
    total, count = np.zeros(lags), np.zeros(lags)
    for part in parts:
        upto = min(lags, part.size)
        size = 1 << (2 * part.size - 1).bit_length()
        products = np.fft.irfft(np.abs(np.fft.rfft(part, size)) ** 2, size)[:upto]
        total[:upto] += products
        count[:upto] += part.size - np.arange(upto)
    return total / np.maximum(count, 1.0), count
