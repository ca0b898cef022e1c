"""Static maps r(theta): along a slow ramp as in the paper, and settled at fixed theta."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_loop import static_map
from koop_loop.static_map import SETTLING
from koop_study.simulation.case import Case
from koop_study.simulation.run import run

HIGH, LOW = 2.0, -5.0  # the paper's ramp (section 4)
SPACING = 0.25  # of the points that ramp and settled map share
SMOOTHING = 3  # points of the moving average before the second differences


class MapShape(NamedTuple):
    """How suitable a static map is for extremum seeking.

    Attributes
    ----------
    convexity : float
        Share of the smoothed map's second differences that are >= 0; 1 for a convex map.
    rank_correlation : float
        Spearman's, of r with |theta - theta*|; 1 for a map that rises monotonously both ways.
    argmin, minimum : float
        theta of the smoothed map's smallest value, and that value.
    """

    convexity: float
    rank_correlation: float
    argmin: float
    minimum: float


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
    case = replace(case, duration=duration + SETTLING)
    settle = round(SETTLING / case.plant.dt)
    falling = np.linspace(HIGH, LOW, case.steps - settle, dtype=np.float64)
    trace = run(case, schedule=np.concatenate([np.full(settle, HIGH), falling]))
    return falling, trace.r[settle:]


def binned(theta: NDArray[np.float64], r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of r, where it is finite, around every point of :func:`grid`, shape (G,)."""
    centres = grid()
    usable = np.isfinite(r)
    theta, r = theta[usable], r[usable]
    nearest = np.rint((HIGH - theta) / SPACING).astype(np.int64)
    sums = np.bincount(nearest, r, minlength=centres.size)
    return np.asarray(sums / np.bincount(nearest, minlength=centres.size))


def settled(case: Case, theta: float) -> NDArray[np.float64]:
    """Return r at constant ``theta`` over one period of the damping drift, without transient."""
    return static_map.settled(case.plant, _resting(case), theta)


def optimal_cost(case: Case) -> float:
    """Return r* of the case's loop, with the optimum at rest where the plant has it."""
    still = replace(case.scenario, optimum_swing=0.0, optimum_jump=0.0)
    return static_map.optimal_cost(case.plant, _resting(replace(case, scenario=still)))


def _resting(case: Case) -> static_map.Cost:
    def cost(theta: float, duration: float) -> NDArray[np.float64]:
        longer = replace(case, duration=duration)
        return run(longer, schedule=np.full(longer.steps, theta)).r

    return cost
