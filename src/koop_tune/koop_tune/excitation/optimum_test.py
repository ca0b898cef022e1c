"""Has a static map an optimum inside, or only slopes? Points with errors in, figures out.

Of all curves that fall and then rise, and of all that only fall or only rise, those are fitted that
are nearest to the points (isotonic regression). The evidence for an optimum inside is by how much
chi-squared of the second is larger:

    evidence = min(chi2_rising, chi2_falling) - chi2_valley
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from koop_core.config.parameter import parameter, validate
from koop_tune.origin import studied


class Evidence(NamedTuple):
    """What points say about an optimum.

    Attributes
    ----------
    gain : float
        By how much a valley fits better than a slope, in chi-squared.
    rising : bool
        Whether, of the slopes, the rising one is nearer.
    """

    gain: float
    rising: bool


@dataclass(frozen=True)
class OptimumTest:
    """Thresholds of the test, and the decisions made with them.

    Points are given as ``y``, of which the least are the best, with standard errors; shape (N,).
    """

    gain: float = parameter(
        12.0, "evidence from which on there is an optimum inside", low=0.0,
        origin="3 sigma, and a margin for the choice of the feature",
    )  # fmt: skip
    margin: float = studied(1.5, "factor on that, with which an excitation ends", low=1.0)
    end: float = studied(1.5, "standard errors by which an end is better, if the best", low=0.0)
    clear: float = parameter(3.0, "the same where there is no optimum", low=0.0, origin="3 sigma")
    flat: float = studied(25.0, "chi-squared about a constant of 9 points of nothing", low=0.0)

    def __post_init__(self) -> None:
        validate(self)

    def is_flat(self, y: NDArray[np.float64], error: NDArray[np.float64]) -> bool:
        """Return whether points show nothing at all."""
        return clarity(y, error) < self.flat * max(1.0, (y.size - 1) / 8.0)

    def best_end(self, y: NDArray[np.float64], error: NDArray[np.float64]) -> int | None:
        """Return the end, 0 or N - 1, that is the best of all beyond doubt; None if none is.

        The two points beside it count together: one of them may be as good by chance.
        """
        best = int(np.argmin(y))
        if best not in (0, y.size - 1):
            return None
        beside = [1, 2] if best == 0 else [y.size - 2, y.size - 3]
        difference = float(y[beside].mean() - y[best])
        deviation = math.hypot(error[best], 0.5 * math.hypot(*error[beside]))
        return best if difference > self.end * deviation else None

    def undecided(self, y: NDArray[np.float64], error: NDArray[np.float64]) -> list[int]:
        """Return the points that leave open whether there is an optimum inside.

        Those from the best one to the end towards which it may only get better; empty if it is
        decided.
        """
        evidence = weigh(y, error)
        if evidence.gain > self.margin * self.gain or self.is_flat(y, error):
            return []
        best, last = int(np.argmin(y)), y.size - 1
        if best in (0, last):
            beside = 1 if best == 0 else last - 1
            if y[beside] - y[best] > self.clear * math.hypot(error[beside], error[best]):
                return []
        if evidence.rising:
            return list(range(min(max(best, 1), last) + 1))
        return list(range(max(min(best, last - 1), 0), last + 1))


def weigh(y: NDArray[np.float64], error: NDArray[np.float64]) -> Evidence:
    """Return the evidence for an optimum inside; arguments as of :class:`OptimumTest`."""
    left, right = _misfits(y, error)
    valley = min(left[k] + right[k] for k in range(y.size + 1))
    return Evidence(float(min(right[0], left[-1]) - valley), right[0] < left[-1])


def nearest_valley(y: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of the nearest curve that falls and then rises."""
    w = 1.0 / error**2
    left, right = _misfits(y, error)
    k = min(range(y.size + 1), key=lambda k: left[k] + right[k])
    return np.concatenate(
        [
            isotonic_regression(y[:k], weights=w[:k], increasing=False).x if k else y[:0],
            isotonic_regression(y[k:], weights=w[k:]).x if k < y.size else y[:0],
        ]
    )


def clarity(y: NDArray[np.float64], error: NDArray[np.float64]) -> float:
    """Return chi-squared of points about a constant."""
    w = 1.0 / error**2
    return float((w * (y - np.average(y, weights=w)) ** 2).sum())


def _misfits(y: NDArray[np.float64], error: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return chi-squared of the first k points about a falling curve, of the rest about a rising.

    Each list has one for k = 0 .. N.
    """
    w = 1.0 / error**2
    return _falling(y, w), _falling(y[::-1], w[::-1])[::-1]


def _falling(y: NDArray[np.float64], w: NDArray[np.float64]) -> list[float]:
    """Return chi-squared of the first 0, 1 .. n points about the nearest falling curve."""
    misfits = [0.0]
    for k in range(1, y.size + 1):
        fit = isotonic_regression(y[:k], weights=w[:k], increasing=False).x
        misfits.append(float((w[:k] * (y[:k] - fit) ** 2).sum()))
    return misfits
