"""Run a case, closed or along a given theta, and measure it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_loop.loop import LoopDiverged, check_fit, simulate
from koop_loop.metrics import evaluate
from koop_study.simulation.case import Case, model_of
from koop_study.simulation.scenario import displacement, expose
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel


@dataclass(frozen=True)
class Trace:
    """Cost and control input of one run, one row a step, both of no row if the plant diverged.

    Attributes
    ----------
    t : ndarray, shape (M,)
        Time [s].
    r, theta : ndarray, shape (M,) or (0,)
        Cost and control input.
    ground_truth : ndarray, shape (M, 2) or (0, 2)
        True state.
    """

    t: NDArray[np.float64]
    r: NDArray[np.float64]
    theta: NDArray[np.float64]
    ground_truth: NDArray[np.float64]

    @property
    def diverged(self) -> bool:
        """True if the plant's state left the finite numbers."""
        return self.theta.size < self.t.size


def run(case: Case, schedule: NDArray[np.float64] | None = None) -> Trace:
    """Run ``case``; with ``schedule``, shape (M,), theta follows it and the controller is idle.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the parts of the case do not fit together.
    """
    model = model_of(case)
    lifter = lifter_of(case, model)
    exposure = expose(
        case.scenario, case.plant, case.steps, case.plant.seed, schedule, case.sensing.indices,
        (lifter.timeout, case.esc.timeout),
    )  # fmt: skip
    t = np.arange(case.steps, dtype=np.float64) * case.plant.dt
    try:
        done = simulate(case.plant, lifter, case.esc, model, case.steps, exposure)
    except LoopDiverged:
        return Trace(t, np.empty(0), np.empty(0), np.empty((0, 2)))
    return Trace(t, done.r, done.theta, done.ground_truth)


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


def measure(case: Case, trace: Trace, r_star: float | None = None) -> Row:
    """Return the paper's metrics of a run; theta* may have moved.

    A run that diverged has infinite errors: it counts as the worst of all, not as absent.

    Returns
    -------
    dict
        ``iae``, ``ise``, ``t_theta`` (None if never reached), ``e_r_ss`` (None without an r*),
        ``tail`` (mean error over the last 30 %), ``reached`` and ``converged`` (1 or 0).
    """
    if trace.diverged:
        return {
            "iae": math.inf, "ise": math.inf, "t_theta": None, "e_r_ss": None,
            "tail": math.inf, "reached": 0.0, "converged": 0.0,
        }  # fmt: skip
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
