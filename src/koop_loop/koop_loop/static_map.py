"""The static map r(theta): the cost that settles at a constant control input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from koop_loop.loop import simulate
from koop_loop.parameters import LoopParameters
from koopman_lifter.model import KoopmanModel

SETTLING = 60.0  # [s] left out: the detector's slowest filter has settled after 20 s


def settled_cost(parameters: LoopParameters, model: KoopmanModel | None, theta: float) -> float:
    """Return the mean cost at constant ``theta`` over one period of the damping drift."""
    period = 2.0 * np.pi / max(parameters.plant.drift_frequency, 1e-3)
    dt = parameters.plant.dt
    result = simulate(
        replace(parameters.plant, theta_initial=theta),
        parameters.lifter,
        replace(parameters.esc, theta_initial=theta, step_size=0.0),
        model,
        round((SETTLING + period) / dt),
    )
    return float(result.r[round(SETTLING / dt) :].mean())


def optimal_cost(parameters: LoopParameters, model: KoopmanModel | None) -> float:
    """Return r*, the settled cost at theta*, for the metric e_r^ss."""
    return settled_cost(parameters, model, parameters.plant.theta_star)
