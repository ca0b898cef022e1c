"""A static map: the logarithm of a level over theta, with what is not known of it.

Holds of theta gave levels with errors; a Gaussian process (Rasmussen and Williams, Gaussian
Processes for Machine Learning, 2006) with a Matern kernel is conditioned on them. Its white part is
what holds at one theta differ by beyond their errors: memory of where theta came from.

An optimum may move while theta is held here and there. A hold at u, of an age t, then tells about
u + v t as it is now; the v with the largest likelihood counts if it is beyond doubt.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged, parameter
from koop_tune.origin import studied

GRID = 1025  # points of a curve between 0 and 1
Array = NDArray[np.float64]


@dataclass(frozen=True)
class MapSettings(Settings):
    """How a static map is fitted and judged."""

    least_error: float = studied(0.003, "least standard error of a log level", low=1e-6)
    smoothness: float = parameter(
        1.5, "nu of the Matern kernel", low=0.5,
        origin="random maps: half the holds of 0.5, and not blind to a narrow valley as 2.5",
    )  # fmt: skip
    shortest: float = parameter(0.02, "shortest length scale, in ranges", low=1e-3)
    scatter: float = studied(0.5, "largest deviation of holds at one theta", low=0.0)
    good: float = studied(1.5, "level over the best of the valley", low=1.0)
    ends: float = studied(2.0, "standard errors by which an end is worse", low=0.0)
    slight: float = studied(0.03, "the same as a log level, at least", low=0.0)
    flat: float = studied(25.0, "chi-squared about a constant of 9 holds of nothing", low=0.0)
    fastest: float = studied(1.0, "motion of the optimum from first to last hold, in ranges")
    moves: float = studied(4.0, "log likelihood that a motion must gain", low=0.0)
    alike: float = judged(0.1, "least length scale of a map that moves, in ranges", low=0.0)
    jump: float = parameter(8.0, "factor of a cliff", low=1.0)
    cliff: float = parameter(0.5, "width of a cliff over the one of the valley beside", low=0.0)


MAP = MapSettings()


def times_best(factor: float, sense: float) -> str:
    """Return in words how far a level is from the best: below it, where it is to be large.

    >>> times_best(1.5, 1.0), times_best(1.5, -1.0)
    ('1.5 times the best', '1/1.5 of the best')
    """
    return f"{factor:.3g} times the best" if sense > 0.0 else f"1/{factor:.3g} of the best"


class Interval(NamedTuple):
    """Positions from ``low`` to ``high``."""

    low: float
    high: float

    @property
    def width(self) -> float:
        """Its length."""
        return self.high - self.low


class Cliff(NamedTuple):
    """A jump beside good holds: last good position, first bad one, difference of logs."""

    inner: float
    outer: float
    height: float


@cache
def of_one(kernel: type[Any], name: str) -> type[Any]:
    """Return a scikit-learn kernel that knows its one hyperparameter.

    Scikit-learn looks for it in the signature of the kernel, two thirds of the time of a fit.
    """

    def log(self: Any) -> Array:
        return np.log([getattr(self, name)])

    def set_exp(self: Any, theta: Array) -> None:
        setattr(self, name, np.exp(theta[0]))

    return type(kernel.__name__, (kernel,), {"theta": property(log, set_exp)})


@cache
def blas_threads() -> Any:
    """Return what limits the threads of BLAS; to find its libraries takes a tenth of a fit.

    They must have been imported.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def variance_of(error: Array) -> Array:
    """Return variances of holds, shape (N,), of their standard errors."""
    return np.asarray(np.clip(error, MAP.least_error, 3.0) ** 2)


def fit_process(kernel: Any, u: Array, y: Array, error: Array) -> Any:
    """Return a Gaussian process conditioned on y, shape (N,), at positions, shape (N, n)."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor

    process = GaussianProcessRegressor(
        kernel, alpha=variance_of(error), n_restarts_optimizer=1, random_state=0
    )
    # threads only wait for each other over matrices as small as these: five times the time
    with blas_threads().limit(limits=1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a bound is an answer here
        return process.fit(u, y)


@dataclass(frozen=True)
class StaticMap:
    """Logarithm of a level at holds of theta.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Position of theta at each hold, 0 to 1; of a map that moves, where the hold would be now.
    mean, error : ndarray, shape (N,)
        Logarithm of the level, and its standard error.
    sense : float
        +1 if little is wanted, else -1.
    motion : float
        Way of the map from the first hold to the last, in ranges.
    """

    u: Array
    mean: Array
    error: Array
    sense: float = 1.0
    motion: float = 0.0

    def now(self, time: Array) -> StaticMap:
        """Return the map as it is at the last of the holds' times, shape (N,).

        A motion that is not beyond doubt is none, nor one of a map that differs from hold to hold:
        where an oscillation comes and goes, some motion explains by chance which were quiet.
        """
        s, found = MAP, self
        age = (time.max() - time) / max(float(np.ptp(time)), 1e-12)
        for reach in (s.fastest, 0.1 * s.fastest):
            kernel = found._fit[0].kernel_
            ways = found.motion + reach * np.linspace(-1.0, 1.0, 41)
            moved = [replace(self, u=self.u + way * age, motion=float(way)) for way in ways]
            likely = max(moved, key=lambda each: each._log_likelihood(kernel))
            if likely.motion == found.motion:
                break
            found = likely
        kernels = [each._fit[0].kernel_ for each in (self, found)]
        gain = found._log_likelihood(kernels[1]) - self._log_likelihood(kernels[0])
        return found if gain > s.moves and kernels[1].k1.k2.length_scale > s.alike else self

    def _log_likelihood(self, kernel: Any) -> float:
        """Return the logarithm of the marginal likelihood of the holds."""
        from scipy.stats import multivariate_normal  # slow to import

        covariance = kernel(self.u[:, None]) + np.diag(variance_of(self.error))
        return float(multivariate_normal.logpdf(self.y - self.y.mean(), cov=covariance))

    @cached_property
    def _fit(self) -> tuple[Any, float]:
        """The conditioned process of y, less the mean of y."""
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        s = MAP
        kernel = of_one(ConstantKernel, "constant_value")(1.0, (0.01, 30.0)) * of_one(
            Matern, "length_scale"
        )(0.3, (s.shortest, 3.0), nu=s.smoothness) + of_one(WhiteKernel, "noise_level")(
            1e-4, (1e-6, s.scatter**2)
        )
        middle = float(self.y.mean())
        return fit_process(kernel, self.u[:, None], self.y - middle, self.error), middle

    @property
    def _white(self) -> float:
        """Variance of the process's white part, which is no doubt about the map."""
        return float(self._fit[0].kernel_.k2.noise_level)

    @property
    def y(self) -> Array:
        """Levels, the least of which is the best."""
        return np.asarray(self.sense * self.mean)

    def predict(self, u: Array) -> tuple[Array, Array]:
        """Return y and its standard error at positions, shape (M,)."""
        process, middle = self._fit
        y, deviation = process.predict(u[:, None], return_std=True)
        return y + middle, np.sqrt(np.maximum(deviation**2 - self._white, 1e-12))

    def difference(self, a: float, b: float) -> tuple[float, float]:
        """Return y(a) - y(b) and its standard error."""
        process, _ = self._fit
        y, covariance = process.predict(np.array([[a], [b]]), return_cov=True)
        covariance -= self._white * np.eye(2)
        variance = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
        return float(y[0] - y[1]), math.sqrt(max(float(variance), 1e-12))

    @cached_property
    def grid(self) -> Array:
        """Positions of the curve, shape (GRID,)."""
        return np.asarray(np.linspace(0.0, 1.0, GRID))

    @cached_property
    def _curve(self) -> tuple[Array, Array]:
        """Prediction on the grid."""
        return self.predict(self.grid)

    @property
    def curve(self) -> Array:
        """The map on the grid: logarithm of the level."""
        return np.asarray(self.sense * self._curve[0])

    @property
    def deviation(self) -> Array:
        """Standard error of the curve."""
        return self._curve[1]

    def draw(self, normal: Array) -> Array:
        """Return maps that the holds allow, shape (K, GRID), of normal numbers, shape (K, GRID).

        The same numbers give two maps the same side of their errors.
        """
        process, middle = self._fit
        coarse = np.linspace(0.0, 1.0, 129)
        places = np.unique(np.r_[coarse, np.clip(self.u, 0.0, 1.0)])
        y, covariance = process.predict(places[:, None], return_cov=True)
        covariance -= self._white * np.eye(places.size)
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        at = np.round(places * (GRID - 1)).astype(int)
        drawn = y + middle + normal[:, at] @ root
        return np.array([self.sense * np.interp(self.grid, places, row) for row in drawn])

    @cached_property
    def _best(self) -> tuple[float, float]:
        """Position of the best hold, and y there."""
        u = np.clip(self.u, 0.0, 1.0)
        y = self.predict(u)[0]
        i = int(np.argmin(y))
        return float(u[i]), float(y[i])

    def best(self) -> float:
        """Return the position of the optimum among the holds: nothing else was seen."""
        return self._best[0]

    @property
    def least(self) -> float:
        """Value y at the best hold."""
        return self._best[1]

    @property
    def doubt(self) -> float:
        """By how much the least y of the map, holds or not, may be below :attr:`least`: 1 sigma."""
        return self.least - float((self._curve[0] - self.deviation).min())

    @property
    def chi_squared(self) -> float:
        """Chi-squared of the holds about a constant."""
        w = 1.0 / np.maximum(self.error, MAP.least_error) ** 2
        return float((w * (self.mean - np.average(self.mean, weights=w)) ** 2).sum())

    @property
    def flat(self) -> bool:
        """Whether the holds show nothing at all."""
        return self.chi_squared < MAP.flat * max(1.0, (self.u.size - 1) / 8.0)

    def worse_by(self, end: float) -> tuple[float, float]:
        """Return by how much an end is worse than the best, and in standard errors."""
        best = self.best()
        if best == end:
            return 0.0, 0.0
        step, error = self.difference(end, best)
        return step, step / error

    @cached_property
    def interior(self) -> bool:
        """Whether there is an optimum inside: both ends are worse."""
        s, ends = MAP, [self.worse_by(end) for end in (0.0, 1.0)]
        return all(step > s.slight and sure > s.ends for step, sure in ends)

    @cached_property
    def evidence(self) -> float:
        """Evidence for an optimum inside (chi-squared)."""
        return min(max(sure, 0.0) ** 2 for _, sure in map(self.worse_by, (0.0, 1.0)))

    @property
    def best_end(self) -> float | None:
        """The end, 0 or 1, that is better than all inside beyond doubt; None if none is."""
        best = self.best()
        for end, inner in ((0.0, 0.125), (1.0, 0.875)):
            if best == end:
                step, error = self.difference(inner, end)
                if step > 1.5 * error:
                    return end
        return None

    def valley(self, factor: float | None = None) -> Interval:
        """Return the positions around the best up to where the curve is ``factor`` times it."""
        good = self._curve[0] <= self.least + math.log(factor or MAP.good)
        i = round(self.best() * (GRID - 1))
        below, above = np.flatnonzero(~good[:i]), np.flatnonzero(~good[i + 1 :])
        low = self.grid[below[-1] + 1] if below.size else 0.0
        high = self.grid[i + above[0]] if above.size else 1.0
        best = self.best()
        return Interval(min(float(low), best), max(float(high), best))

    def basin(self) -> Interval:
        """Return the positions around the best from which the curve leads to it.

        A ripple that the errors explain is no ridge.
        """
        y, deviation = self._curve
        ends = []
        i = round(self.best() * (GRID - 1))
        for side in (-1, 1):
            top, edge = i, 0 if side < 0 else GRID - 1
            for k in range(i, edge + side, side):
                if y[k] > y[top]:
                    top = k
                elif y[top] - y[k] > 2.0 * math.hypot(deviation[top], deviation[k]) + 0.1:
                    edge = top
                    break
            ends.append(float(self.grid[edge]))
        return Interval(*ends)

    def cliff(self, side: int) -> Cliff | None:
        """Return the cliff beside the good holds on a side, -1 or 1, if there is one.

        A cliff has a good and a bad side, the valley of a narrow optimum two bad ones: the jump of
        a cliff is narrow beside the valley.
        """
        s = MAP
        order = np.argsort(side * self.u)
        u, y = self.u[order], self.y[order]
        best = float(self.least)
        beyond = np.flatnonzero((side * (u - self.best()) > 0.0) & (y - best > math.log(s.jump)))
        if not beyond.size:
            return None
        outer = float(u[beyond[0]])
        inside = side * (u - outer) < 0.0
        good = np.flatnonzero(inside & (y - best < math.log(2.0)))
        inner = float(u[good[-1]]) if good.size else self.best()
        if abs(outer - inner) > s.cliff * self.valley(2.0).width:
            return None
        return Cliff(inner, outer, float(y[beyond[0]]) - best)

    def expected_improvement(self, u: Array, floor: float = -math.inf) -> Array:
        """Return by how much a hold at positions is expected to be better than the best so far.

        ``floor`` is the least y that a hold can have.
        """
        from scipy.stats import norm  # slow to import

        y, deviation = self.predict(u)

        def below(bound: float) -> Array:
            z = (bound - y) / deviation
            return np.asarray(deviation * (z * norm.cdf(z) + norm.pdf(z)))

        return below(self.least) - (below(min(floor, self.least)) if floor > -math.inf else 0.0)
