"""The static map r(theta): the cost at a constant control input, and its value at the optimum, r*.

The paper takes r* from a ramp of theta, which meets every theta at another phase of the damping's
drift. Here theta rests at theta* for one whole period of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koop_loop.loop import simulate
from koop_loop.metrics import LOGGING_START, Metrics, evaluate
from koop_loop.parameters import LoopParameters
from koop_loop.settings import METRICS
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig

SETTLING = LOGGING_START  # [s] before r counts: the paper's transient
UNLIMITED = 1e6  # limits of a theta that is held


def settled(
    parameters: LoopParameters, model: KoopmanModel | None, theta: float
) -> NDArray[np.float64]:
    """Return r at constant ``theta`` over one period of the damping drift, without transient."""
    plant = parameters.plant.knob(0, coupling=())
    held = min(max(theta, plant.theta_min), plant.theta_max)  # what the actuator can reach
    still = EscConfig(theta_initial=held, step_size=0.0, theta_min=-UNLIMITED, theta_max=UNLIMITED)
    drift = plant.drift_frequency
    period = 2.0 * np.pi / drift if drift > 0.0 else METRICS.without_drift
    steps = round((SETTLING + period) / plant.dt)
    resting = replace(plant, theta_initial=held)
    r = simulate(resting, parameters.lifter, still, model, steps).r
    return r[round(SETTLING / plant.dt) :]


def optimal_cost(parameters: LoopParameters, model: KoopmanModel | None) -> float:
    """Return r*, the cost where theta rests at theta*; of several knobs, where the first does."""
    theta_star = parameters.plant.knob(0, coupling=()).theta_star
    return float(np.nanmean(settled(parameters, model, theta_star)))


def performance(
    parameters: LoopParameters,
    model: KoopmanModel | None,
    t: NDArray[np.float64],
    theta: NDArray[np.float64],
    r: NDArray[np.float64],
) -> Metrics:
    """Return the paper's metrics of a run of our plant, with r* of its own loop.

    Time [s], control input and cost as :func:`koop_loop.metrics.evaluate` takes them.
    """
    r_star = optimal_cost(parameters, model)
    return evaluate(t, theta, r, parameters.plant.theta_star, r_star)
