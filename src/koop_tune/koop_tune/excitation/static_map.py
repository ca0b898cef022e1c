"""A static map with its errors: has it an optimum inside, and what is it between its points?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from koop_tune.excitation.optimum_test import Evidence, OptimumTest, clarity, nearest_valley, weigh
from koop_tune.origin import jsbsim, studied

GRID = 257  # points of a curve between 0 and 1


@dataclass(frozen=True)
class MapSettings(OptimumTest):
    """How errors, curve, optimum and cliffs of a static map are found."""

    least_error: float = studied(0.003, "least standard error of a log amplitude", low=1e-6)
    outlying: float = studied(10.0, "most that a point's variance counts, over the median", low=1.0)
    single: float = studied(2.0, "chi-squared of a point of a curve with one optimum", low=0.0)
    good: float = studied(2.0, "amplitude over the best one of a good value's visits", low=1.0)
    cliff: float = jsbsim(8.0, "factor to a neighbour; less is a steep side of a valley", low=1.0)


MAP = MapSettings()


class Cliff(NamedTuple):
    """A jump beside good values: the last good point, the first one beyond, difference of logs."""

    inner: int
    outer: int
    height: float


@dataclass(frozen=True)
class StaticMap:
    """Logarithm of a level, a root mean square, at each value of theta.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Positions of theta, rising.
    mean, error : ndarray, shape (N,)
        Its standard error counts that visits differ.
    sense : float
        +1 if little is wanted, else -1.
    visits : list of ndarray
        Levels of the visits of each value.
    settings : MapSettings
        How it is judged.
    """

    u: NDArray[np.float64]
    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    sense: float
    visits: list[NDArray[np.float64]]
    settings: MapSettings = MAP

    @classmethod
    def from_visits(
        cls,
        u: NDArray[np.float64],
        visits: Sequence[tuple[int, float, float]],
        sense: float,
        settings: MapSettings = MAP,
    ) -> StaticMap:
        """Return the map of visits.

        Parameters
        ----------
        u : ndarray, shape (N,)
            Positions of theta, rising; each was visited.
        visits : sequence of (int, float, float)
            Number of the position, level and standard error of each visit.
        sense, settings
            See the class.
        """
        levels: list[list[float]] = [[] for _ in u]
        errors: list[list[float]] = [[] for _ in u]
        for place, level, error in visits:
            levels[place].append(level)
            errors[place].append(error)
        groups = [np.array(group) for group in levels]
        variances = [float(v.var(ddof=1)) for v in groups if v.size > 1]
        most = settings.outlying * float(np.median(variances)) if variances else 0.0
        spare = sum(v.size - 1 for v in groups)
        squares = [min(float(v.var(ddof=1)), most) * (v.size - 1) for v in groups if v.size > 1]
        pooled = sum(squares) / max(spare, 1)
        total = []
        for v, e in zip(groups, errors, strict=True):
            within = float(np.sqrt((np.array(e) ** 2).sum())) / v.size
            alone = float(v.var(ddof=1)) if v.size > 1 else pooled
            between = math.sqrt(0.5 * (pooled + alone) / v.size)
            total.append(max(within, between, settings.least_error))
        mean = np.array([v.mean() for v in groups])
        return cls(u, mean, np.array(total), sense, groups, settings)

    @property
    def y(self) -> NDArray[np.float64]:
        """Levels, the least of which is the best."""
        return np.asarray(self.sense * self.mean)

    @property
    def evidence(self) -> Evidence:
        """Evidence for an optimum inside."""
        return weigh(self.y, self.error)

    @property
    def interior(self) -> bool:
        """Whether there is an optimum inside."""
        return self.evidence.gain > self.settings.gain and 0.0 < self.best() < 1.0

    @property
    def flat(self) -> bool:
        """Whether the points show nothing at all."""
        return self.settings.is_flat(self.mean, self.error)

    @property
    def clarity(self) -> float:
        """How much the map stands out from its errors, in chi-squared."""
        return clarity(self.mean, self.error)

    @property
    def best_end(self) -> int | None:
        """The end, 0 or N - 1, that is the best beyond doubt; None if none is."""
        return self.settings.best_end(self.y, self.error)

    @property
    def undecided(self) -> list[int]:
        """Points that leave open whether there is an optimum inside."""
        return self.settings.undecided(self.y, self.error)

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
        single = self.sense * nearest_valley(self.sense * smooth, self.error)
        if float((w * (single - mean) ** 2).sum()) < self.settings.single * n:
            smooth = single
        grid = np.clip(np.linspace(0.0, 1.0, GRID), self.u[0], self.u[-1])
        return np.asarray(PchipInterpolator(self.u, smooth)(grid))

    def cliff(self, side: int) -> Cliff | None:
        """Return the cliff beside the good values on a side, -1 or 1, if there is one.

        What a rig does beside a cliff may depend on where it comes from: good is a value of which
        every visit was, beyond the cliff is one of which any was.
        """
        y = self.y
        worst = [float((self.sense * levels).max()) for levels in self.visits]
        inner = best = int(np.argmin(y))
        while 0 <= inner + side < y.size and (
            worst[inner + side] - y[best] < math.log(self.settings.good)
        ):
            inner += side
        outer = inner + side
        if not 0 <= outer < y.size:
            return None
        height = worst[outer] - float(y[inner])
        return Cliff(inner, outer, height) if height > math.log(self.settings.cliff) else None

    def draw_weights(self, rng: np.random.Generator) -> list[NDArray[np.float64]]:
        """Return random weights of each value's visits (the Bayesian bootstrap; Rubin 1981)."""
        return [rng.dirichlet(np.ones(v.size)) for v in self.visits]

    def reweigh(self, weights: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the points as other visits might have given them.

        ``weights``, of each value's visits, sum to 1; see :meth:`draw_weights`.
        """
        points = self.mean.copy()
        for i, (levels, weight) in enumerate(zip(self.visits, weights, strict=True)):
            spread = float(levels.std()) / math.sqrt(levels.size)
            shift = float(weight @ levels - levels.mean())
            # visits that happen to agree know no more than their errors say
            points[i] += shift * self.error[i] / spread if spread > 1e-12 else 0.0
        return points
