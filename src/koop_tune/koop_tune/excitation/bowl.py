"""A bowl over several knobs: what an amplitude is like around its optimum, the knobs coupled.

    2 log A = log(exp c + |B (u - u*)|^2),   B upper triangular

is fitted to holds: holds along each knob tell all but how the knobs are coupled, two holds to
either side of a pair of knobs tell that too.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged
from koop_tune.rig.rig_file import RigFile

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BowlSettings(Settings):
    """How a bowl is fitted."""

    error: float = judged(0.1, "log amplitude by which holds may be off any bowl", low=1e-3)
    near: float = judged(
        3.0, "distance of u* from the best hold that is likely, in ranges", low=0.1
    )
    beyond: float = judged(0.3, "how far u* may lie outside the range, in ranges", low=0.0)
    tries: int = judged(4, "starts of the fit", low=1)
    most: int = judged(60, "evaluations of each", low=10)


BOWL = BowlSettings()


@dataclass(frozen=True)
class Bowl:
    """A bowl.

    Attributes
    ----------
    floor : float
        c.
    best : ndarray, shape (n,)
        u*.
    root : ndarray, shape (n, n)
        B.
    """

    floor: float
    best: Array
    root: Array

    def log(self, u: Array) -> Array:
        """Return log A at positions, shape (M, n)."""
        way = (u - self.best) @ self.root.T
        return np.asarray(0.5 * np.logaddexp(self.floor, np.log((way**2).sum(axis=1) + 1e-300)))


def fit_bowl(u: Array, y: Array, error: Array) -> Bowl:
    """Fit a bowl to log amplitudes y, shape (M,), at positions u, shape (M, n); u* is inside."""
    from scipy.optimize import least_squares  # slow to import

    s, n = BOWL, u.shape[1]
    upper, rng = np.triu_indices(n), np.random.default_rng(u.shape[0])
    centre, size = u[np.argmin(y)], np.exp(y.max())
    sigma = np.hypot(error, s.error)

    def bowl_of(p: Array) -> Bowl:
        root = np.zeros((n, n))
        root[upper] = size * p[1 + n :]
        return Bowl(float(p[0]), p[1 : 1 + n], root)

    def residuals(p: Array) -> Array:
        off = (bowl_of(p).log(u) - y) / sigma
        return np.concatenate([off, (p[1 : 1 + n] - centre) / s.near, 0.02 * p[1 + n :]])

    low = np.r_[2.0 * y.min() - 6.0, np.full(n, -s.beyond), np.full(upper[0].size, -1e4)]
    high = np.r_[2.0 * y.max() + 1e-3, np.full(n, 1.0 + s.beyond), np.full(upper[0].size, 1e4)]

    def begin(spread: float) -> Array:
        root = np.eye(n) + 2.5 * spread * rng.standard_normal((n, n))
        near = np.clip(centre + spread * rng.standard_normal(n), 0.0, 1.0)
        return np.clip(np.r_[2.0 * y.min() - 0.5, near, root[upper]], low + 1e-6, high - 1e-6)

    fits = [
        least_squares(
            residuals, begin(0.2 * (i > 0)), bounds=(low, high), loss="soft_l1", max_nfev=s.most
        )
        for i in range(s.tries)
    ]
    found = bowl_of(min(fits, key=lambda fit: float(fit.cost)).x)
    return Bowl(found.floor, np.clip(found.best, 0.0, 1.0), found.root)


def find_starts(rig: RigFile, u: Array, y: Array, error: Array) -> list[tuple[float, ...]]:
    """Return thetas from which loops are closed: the ends of the range.

    Of several knobs the corner that the holds let expect to be the worst, and the opposite one
    before it: each knob begins at both of its ends, or as near as lines between them let it.

    Parameters
    ----------
    rig : RigFile
        The rig, with n knobs.
    u, y, error
        The holds of its excitation, as of :func:`fit_bowl`.
    """
    n = rig.count
    if n == 1:
        return [rig.each("theta_min"), rig.each("theta_max")]
    corners = [rig.limit(rig.theta_at(v)) for v in itertools.product((0.0, 1.0), repeat=n)]
    worst = len(corners) - 1
    if y.size > n:
        worst = int(np.argmax(fit_bowl(u, y, error).log(rig.u(corners))))
    return [corners[-1 - worst], corners[worst]]
