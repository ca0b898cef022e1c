"""Has a static map an optimum inside, or only slopes? Pure: points with errors in, figures out.

Of all curves that fall and then rise, and of all that only fall or only rise, those are fitted that
are nearest to the points (isotonic regression). By how much chi-squared of the second is larger
tells whether the ends are worse than the inside.

    gain = min(chi2_rising, chi2_falling) - chi2_valley
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

SURE = 12.0  # gain from which on there is an optimum: 3 sigma, and the choice of the feature
SURER = 1.5  # times that, with which an excitation ends
ENDS = 1.5  # standard errors by which the values beside an end are worse: it is the best
CLEAR = 3.0  # standard errors by which an end is better than the value beside it: there is none
FLAT = 25.0  # chi-squared about a constant, below which 9 values show nothing


class Shape(NamedTuple):
    """What points say.

    Attributes
    ----------
    gain : float
        By how much a valley fits better than a slope, in chi-squared.
    rising : bool
        Whether, of the slopes, the rising one is nearer.
    """

    gain: float
    rising: bool


def shape(y: NDArray[np.float64], error: NDArray[np.float64]) -> Shape:
    """Judge points, of which the least are the best, with their standard errors; shape (N,)."""
    w = 1.0 / error**2
    left = _misfit(y, w, False)  # the first k points fall
    right = _misfit(y[::-1], w[::-1], False)[::-1]  # the last ones rise
    valley = min(left[k] + right[k] for k in range(y.size + 1))
    return Shape(float(min(right[0], left[-1]) - valley), right[0] < left[-1])


def nearest(y: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of the nearest curve that falls and then rises."""
    w = 1.0 / error**2
    left, right = _misfit(y, w, False), _misfit(y[::-1], w[::-1], False)[::-1]
    k = min(range(y.size + 1), key=lambda k: left[k] + right[k])
    return np.concatenate(
        [
            isotonic_regression(y[:k], weights=w[:k], increasing=False).x if k else y[:0],
            isotonic_regression(y[k:], weights=w[k:]).x if k < y.size else y[:0],
        ]
    )


def flat(y: NDArray[np.float64], error: NDArray[np.float64]) -> bool:
    """Return whether points show nothing at all."""
    return clarity(y, error) < FLAT * max(1.0, (y.size - 1) / 8.0)


def clarity(y: NDArray[np.float64], error: NDArray[np.float64]) -> float:
    """Return chi-squared of points about a constant."""
    w = 1.0 / error**2
    return float((w * (y - np.average(y, weights=w)) ** 2).sum())


def best_end(y: NDArray[np.float64], error: NDArray[np.float64]) -> int | None:
    """Return the end, 0 or N - 1, that is the best of all beyond doubt; None if none is.

    The two values beside it count together: one of them may be as good by chance.
    """
    best = int(np.argmin(y))
    if best not in (0, y.size - 1):
        return None
    beside = [1, 2] if best == 0 else [y.size - 2, y.size - 3]
    way = float(y[beside].mean() - y[best])
    sure = math.hypot(error[best], 0.5 * math.hypot(*error[beside]))
    return best if way > ENDS * sure else None


def in_doubt(y: NDArray[np.float64], error: NDArray[np.float64]) -> list[int]:
    """Return the points that leave open whether there is an optimum inside; empty if none do.

    Those from the best one to the end towards which it may only get better.
    """
    found = shape(y, error)
    if found.gain > SURER * SURE or flat(y, error):
        return []
    best, last = int(np.argmin(y)), y.size - 1
    if best in (0, last):
        beside = 1 if best == 0 else last - 1
        if y[beside] - y[best] > CLEAR * math.hypot(error[beside], error[best]):
            return []
    if found.rising:
        return list(range(min(max(best, 1), last) + 1))
    return list(range(max(min(best, last - 1), 0), last + 1))


def _misfit(y: NDArray[np.float64], w: NDArray[np.float64], rising: bool) -> list[float]:
    """Return chi-squared of the first 0, 1 .. n points about the nearest monotone curve."""
    found = [0.0]
    for k in range(1, y.size + 1):
        fit = isotonic_regression(y[:k], weights=w[:k], increasing=rising).x
        found.append(float((w[:k] * (y[:k] - fit) ** 2).sum()))
    return found
