"""Static maps r(theta): along a slow ramp as in the paper, and settled at fixed theta."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_loop.kernel import Controller
from koop_loop.loop import controller, initial_state
from koop_loop.static_map import SETTLING
from koop_study.simulation.case import Case
from koop_study.simulation.run import loop_of
from koopman_lifter import cost
from koopman_lifter.cost import Workspace
from vdp_plant import dynamics
from vdp_plant.dynamics import PlantParams

HIGH, LOW = 2.0, -5.0  # the paper's ramp (section 4)
SPACING = 0.25  # of the points that ramp and settled map share
SMOOTHING = 3  # points of the moving average before the second differences


class MapShape(NamedTuple):
    """How suitable a static map is for extremum seeking."""

    convexity: float
    """Share of the smoothed map's second differences that are >= 0; 1 for a convex map."""
    rank_correlation: float
    """Spearman's, of r with |theta - theta*|; 1 for a map that rises monotonously both ways."""
    argmin: float
    minimum: float
    """theta of the smoothed map's smallest value, and that value."""


def grid() -> NDArray[np.float64]:
    """Return the values of theta that maps are sampled at, falling, shape (G,)."""
    return np.linspace(HIGH, LOW, round((HIGH - LOW) / SPACING) + 1, dtype=np.float64)


def smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the moving average over three neighbours; the two ends stay out, shape (G - 2,)."""
    return np.convolve(values, np.full(SMOOTHING, 1.0 / SMOOTHING), mode="valid")


def shape(theta: NDArray[np.float64], r: NDArray[np.float64], theta_star: float) -> MapShape:
    """Judge a map that is sampled at equally spaced ``theta``, both shape (G,)."""
    from scipy.stats import spearmanr  # slow to import

    smoothed = smooth(r)
    inner = theta[SMOOTHING // 2 : theta.size - SMOOTHING // 2]
    best = int(np.argmin(smoothed))
    return MapShape(
        float(np.mean(np.diff(smoothed, 2) >= 0.0)),
        float(spearmanr(np.abs(theta - theta_star), r).statistic),
        float(inner[best]),
        float(smoothed[best]),
    )


def ramp(case: Case, duration: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower theta steadily from 2 to -5 after settling at 2.

    Returns
    -------
    theta, r : ndarray, shape (M,)
        The ramp itself, without the settling.
    """
    loop, model = loop_of(case)
    settle, steps = (round(time / case.plant.dt) for time in (SETTLING, duration))
    falling = np.linspace(HIGH, LOW, steps, dtype=np.float64)
    theta = np.concatenate([np.full(settle, HIGH), falling])
    r = np.empty(theta.size)
    parts = controller(loop.lifter, loop.esc, model)
    work = cost.workspace(parts.lifting)
    _follow(case.plant.params(), parts, work, *initial_state(case.plant), theta, r)
    return falling, r[settle:]


@njit()
def _follow(
    plant: PlantParams, parts: Controller, work: Workspace, x: float, y: float,
    theta: NDArray[np.float64], r: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fill ``r`` with the cost along theta, both shape (M,)."""
    detector, applied, state = cost.initial(), theta[0], np.empty(2)
    for k in range(theta.size):
        arrival = Arrival.NEXT if k else Arrival.RESTART
        state[0], state[1] = dynamics.measure(plant, k, x, y)
        r[k], _, _, detector = cost.answer(
            parts.source, parts.lifting, parts.detector, detector, arrival, k, state, work
        )
        x, y, applied = dynamics.advance(plant, k, x, y, applied, theta[k])


def binned(theta: NDArray[np.float64], r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of r, where it is finite, around every point of :func:`grid`, shape (G,)."""
    centres = grid()
    usable = np.isfinite(r)
    theta, r = theta[usable], r[usable]
    nearest = np.rint((HIGH - theta) / SPACING).astype(np.int64)
    sums = np.bincount(nearest, r, minlength=centres.size)
    return np.asarray(sums / np.bincount(nearest, minlength=centres.size))
