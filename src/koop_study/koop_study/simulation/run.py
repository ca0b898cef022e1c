"""Run a case, closed or along a given theta, and measure it.

A moving optimum needs no other plant: the oscillator sees only theta - theta*, so an optimum that
is displaced by s is the same plant fed with theta - s.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_loop.loop import Exposure, LoopResult, check_fit, simulate
from koop_loop.metrics import evaluate
from koop_study.simulation.case import Case, ScenarioConfig
from koop_study.simulation.learning import model_of, second_channel
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantParams
from vdp_plant.waves import Waves, drive_of, interference_of

BOTH = np.arange(2)  # states of the plant


# shared by the runs of a unit and by most units of a study
_drive = lru_cache(maxsize=2)(drive_of)
_interference = lru_cache(maxsize=16)(interference_of)  # the seeds of a unit


def kept_waves(p: PlantParams, steps: int) -> Waves:
    """Return the part of the plant that depends on time alone, cached between runs."""
    without_phases = p._replace(interference_phase_1=0.0, interference_phase_2=0.0)
    return Waves(_drive(without_phases, steps), _interference(p, steps))


@lru_cache(maxsize=1)
def displacement(config: ScenarioConfig, steps: int, dt: float) -> NDArray[np.float64]:
    """Return the displacement of theta*, shape (M,), the same for all seeds; empty if at rest."""
    if config.optimum_swing == 0.0 and config.optimum_jump == 0.0:
        return np.empty(0)
    t = np.arange(steps, dtype=np.float64) * dt
    swing = config.optimum_swing * np.sin(2.0 * np.pi * t / config.optimum_period)
    jumps = config.optimum_jump * (np.floor(t / config.jump_every) % 2.0)
    return np.asarray(swing + jumps)


def expose(
    config: ScenarioConfig,
    plant: PlantConfig,
    steps: int,
    seed: int,
    schedule: NDArray[np.float64] | None = None,
    channels: NDArray[np.int64] = BOTH,
) -> Exposure:
    """Draw the disturbances of one run.

    Parameters
    ----------
    config : ScenarioConfig
        Which disturbances.
    plant : PlantConfig
        Whose interference and step size count.
    steps : int
        Length M of the run.
    seed : int
        Seed of noise and lost samples.
    schedule : ndarray, shape (M,), optional
        Control input for an open-loop run.
    channels : ndarray of int, shape (n,)
        Components of the measured state that the lifter receives.
    """
    rng = np.random.default_rng([seed, 1])
    t = np.arange(steps, dtype=np.float64) * plant.dt
    added: NDArray[np.float64] = np.empty((0, 2))
    second = second_channel(config, plant, t)
    if config.noise > 0.0 or second.size:
        drawn = config.noise > 0.0 or config.lost > 0.0  # which is drawn after it
        added = rng.normal(0.0, config.noise, (steps, 2)) if drawn else np.zeros((steps, 2))
        if second.size:
            added[:, 1] += second
    lost: NDArray[np.bool_] = np.empty(0, dtype=np.bool_)
    if config.lost > 0.0:
        lost = rng.random(steps) < config.lost
        lost[0] = False  # the loop begins with the first state that arrives
    return Exposure(
        added,
        lost,
        displacement(config, steps, plant.dt),
        np.empty(0) if schedule is None else schedule,
        channels,
        kept_waves(plant.params(), steps),
    )


def run(case: Case, schedule: NDArray[np.float64] | None = None) -> LoopResult:
    """Run ``case``; with ``schedule``, shape (M,), theta follows it and the controller is idle.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of the case do not fit together.
    koop_loop.loop.LoopDiverged
        If the plant's state left the finite numbers.
    """
    model = model_of(case)
    lifter = lifter_of(case, model)
    exposure = expose(
        case.scenario, case.plant, case.steps, case.plant.seed, schedule, case.sensing.indices
    )
    return simulate(case.plant, lifter, case.esc, model, case.steps, exposure)


def lifter_of(case: Case, model: KoopmanModel | None) -> LifterConfig:
    """Return the case's lifter with its model's cost.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of the case do not fit together.
    """
    lifter = replace(case.lifter, cost="raw" if model is None else "lifted")
    try:
        check_fit(case.plant, lifter, case.esc, model, case.sensing.indices.size)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return lifter


Row = dict[str, float | None]


DIVERGED: Row = {
    "iae": math.inf, "ise": math.inf, "t_theta": None, "e_r_ss": None, "tail": math.inf,
    "reached": 0.0, "converged": 0.0,
}  # fmt: skip
"""A run that diverged counts as the worst of all, not as absent."""


def measure(case: Case, trace: LoopResult, r_star: float | None = None) -> Row:
    """Return the paper's metrics of a run; theta* may have moved.

    Returns
    -------
    dict
        ``iae``, ``ise``, ``t_theta`` (None if never reached), ``e_r_ss`` (None without an r*),
        ``tail`` (mean error over the last 30 %), ``reached`` and ``converged`` (1 or 0).
    """
    displaced = displacement(case.scenario, trace.t.size, case.plant.dt)
    theta = trace.theta - displaced if displaced.size else trace.theta
    metrics = evaluate(trace.t, theta, trace.r, case.plant.theta_star, r_star)
    return {
        "iae": metrics.iae_theta,
        "ise": metrics.ise_theta,
        "t_theta": metrics.t_theta,
        "e_r_ss": metrics.e_r_ss,
        "tail": metrics.tail_error,
        "reached": float(metrics.t_theta is not None),
        "converged": float(metrics.converged),
    }
