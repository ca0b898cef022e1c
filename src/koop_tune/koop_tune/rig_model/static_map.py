"""A static map with its errors: has it an optimum inside, and what is it between its points?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from koop_tune.excitation import optimum_test
from koop_tune.excitation.staircase import LEAST_ERROR, level
from koop_tune.rig_model.stays import Stays

OUTLYING = 10.0  # times the median variance of a value's visits, that counts for the others at most
SINGLE = 2.0  # chi-squared of a point about the nearest curve with one optimum
GRID = 257  # points of a map between 0 and 1


@dataclass(frozen=True)
class StaticMap:
    """Logarithm of a level, a root mean square, at each value of theta.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Positions of theta.
    mean, error : ndarray, shape (N,)
        Its standard error counts that visits differ.
    sense : float
        +1 if little is wanted.
    visits : list of ndarray
        Means of the visits of each value.
    """

    u: NDArray[np.float64]
    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    sense: float
    visits: list[NDArray[np.float64]]

    @property
    def gain(self) -> float:
        """By how much a valley fits better than a slope, in chi-squared."""
        return optimum_test.shape(self.sense * self.mean, self.error).gain

    @property
    def interior(self) -> bool:
        """Whether there is an optimum inside."""
        return self.gain > optimum_test.SURE and 0.0 < self.best() < 1.0

    @property
    def flat(self) -> bool:
        """Whether the points show nothing at all."""
        return optimum_test.flat(self.mean, self.error)

    @property
    def clarity(self) -> float:
        """How much the map stands out from its errors, in chi-squared."""
        return optimum_test.clarity(self.mean, self.error)

    def best(self) -> float:
        """Return the position of the optimum."""
        curve = self.curve(self.mean)
        grid = np.linspace(0.0, 1.0, GRID)
        return float(grid[int(np.argmin(self.sense * curve))])

    def curve(self, mean: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the map through points, shape (GRID,); as smooth as their errors allow.

        The smoothest (Whittaker 1923) of chi-squared up to the number of points; between them
        PCHIP, which does not overshoot. A map is taken to have one optimum, unless its points
        say otherwise: in a dip that errors made a simulated loop would be caught.
        """
        n, w = self.u.size, 1.0 / self.error**2
        h = np.diff(self.u)
        bend = np.zeros((n - 2, n))
        for i in range(n - 2):
            bend[i, i : i + 3] = [1 / h[i], -1 / h[i] - 1 / h[i + 1], 1 / h[i + 1]]
        smooth = mean
        for strength in np.geomspace(1e4, 1e-4, 33):
            smooth = np.linalg.solve(
                np.diag(w) + strength * np.median(w) * bend.T @ bend * float(h.mean()) ** 2,
                w * mean,
            )
            if float((w * (smooth - mean) ** 2).sum()) <= n:
                break
        else:
            smooth = mean
        single = self.sense * optimum_test.nearest(self.sense * smooth, self.error)
        if float((w * (single - mean) ** 2).sum()) < SINGLE * n:
            smooth = single
        grid = np.clip(np.linspace(0.0, 1.0, GRID), self.u[0], self.u[-1])
        return np.asarray(PchipInterpolator(self.u, smooth)(grid))

    def drawn(self, weights: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the points as other visits might have given them.

        ``weights``, of each value's visits, sum to 1; see :func:`weights_of`.
        """
        found = self.mean.copy()
        for i, (own, weight) in enumerate(zip(self.visits, weights, strict=True)):
            spread = float(own.std()) / math.sqrt(own.size)
            shift = float(weight @ own - own.mean())
            # visits that happen to agree know no more than their errors say
            found[i] += shift * self.error[i] / spread if spread > 1e-12 else 0.0
        return found


def static_map(stays: Stays, windows: list[NDArray[np.float64]], sense: float) -> StaticMap:
    """Return the map of a quantity from its logarithm in the windows of each stay."""
    settled = stays.settled(windows)
    own: list[list[float]] = [[] for _ in stays.u]
    inner: list[list[float]] = [[] for _ in stays.u]
    for stay, values in zip(stays.stays, settled, strict=True):
        mean, error = (float(found[0]) for found in level(values[:, None]))
        own[stay.level].append(mean)
        inner[stay.level].append(error if math.isfinite(error) else float(np.ptp(values)))
    visits = [np.array(group) for group in own]
    alike = [float(v.var(ddof=1)) for v in visits if v.size > 1]
    # where the rig goes to and fro between two amplitudes visits differ as nowhere else
    most = OUTLYING * float(np.median(alike)) if alike else 0.0
    spare = sum(v.size - 1 for v in visits)
    squares = [min(float(v.var(ddof=1)), most) * (v.size - 1) for v in visits if v.size > 1]
    pooled = sum(squares) / max(spare, 1)
    errors = []
    for v, e in zip(visits, inner, strict=True):
        within = float(np.sqrt((np.array(e) ** 2).sum())) / v.size
        alone = float(v.var(ddof=1)) if v.size > 1 else pooled
        errors.append(max(within, math.sqrt(0.5 * (pooled + alone) / v.size), LEAST_ERROR))
    means = np.array([v.mean() for v in visits])
    return StaticMap(stays.u, means, np.array(errors), sense, visits)


def weights_of(maps: StaticMap, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Return random weights of each value's visits (the Bayesian bootstrap; Rubin 1981)."""
    return [rng.dirichlet(np.ones(v.size)) for v in maps.visits]
