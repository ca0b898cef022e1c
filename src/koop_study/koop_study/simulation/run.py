"""Run a case and measure it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

from koop_core.config.parameter import ConfigError
from koop_loop import static_map
from koop_loop.loop import LoopResult, check_fit, simulate
from koop_loop.metrics import evaluate
from koop_loop.parameters import LoopParameters
from koop_loop.training import train
from koop_study.simulation.case import Case
from koopman_lifter.config import ModelConfig
from koopman_lifter.model import KoopmanModel
from vdp_plant.config import PaceConfig, PlantConfig

_train = lru_cache(maxsize=128)(train)  # the costs and settings of a unit share a seed's model


def model_of(case: Case) -> KoopmanModel | None:
    """Return the model that the case's cost needs, trained now or remembered; None for raw.

    The training plant has the paper's phases of the interference: a recording made earlier knows
    nothing of the phase that a run will meet.
    """
    if case.cost == "raw":
        return None
    plant = replace(
        case.plant,
        seed=0,
        initial_state=(),
        theta_initial=PlantConfig.theta_initial,
        interference_phase_1=0.0,
        interference_phase_2=0.0,
    )
    return _train(plant, case.training, case.cost == "contrast")


def loop_of(case: Case) -> tuple[LoopParameters, KoopmanModel | None]:
    """Return the parameters of the case's loop, and its model.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of the case do not fit together.
    """
    model = model_of(case)
    lifter = replace(case.lifter, cost="raw" if model is None else "lifted")
    try:
        check_fit(case.plant, lifter, case.esc, model)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return LoopParameters(case.plant, PaceConfig(), lifter, ModelConfig(), case.esc), model


def run(case: Case) -> LoopResult:
    """Run ``case``.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of the case do not fit together.
    koop_loop.loop.LoopDiverged
        If the plant's state left the finite numbers.
    """
    loop, model = loop_of(case)
    return simulate(loop.plant, loop.lifter, loop.esc, model, case.steps)


Row = dict[str, float | None]


DIVERGED: Row = {
    "iae": math.inf, "ise": math.inf, "t_theta": None, "e_r_ss": None, "tail": math.inf,
    "reached": 0.0, "converged": 0.0,
}  # fmt: skip
"""A run that diverged counts as the worst of all, not as absent."""


def measure(case: Case, done: LoopResult, with_r_star: bool = False) -> Row:
    """Return the paper's metrics of a run.

    Returns
    -------
    dict
        ``iae``, ``ise``, ``t_theta`` (None if never reached), ``e_r_ss`` (None without r*),
        ``tail`` (mean error over the last 30 %), ``reached`` and ``converged`` (1 or 0).
    """
    signals = done.t, done.theta, done.r
    if with_r_star:
        metrics = static_map.performance(*loop_of(case), *signals)
    else:
        metrics = evaluate(*signals, case.plant.theta_star, None)
    return {
        "iae": metrics.iae_theta,
        "ise": metrics.ise_theta,
        "t_theta": metrics.t_theta,
        "e_r_ss": metrics.e_r_ss,
        "tail": metrics.tail_error,
        "reached": float(metrics.t_theta is not None),
        "converged": float(metrics.converged),
    }
