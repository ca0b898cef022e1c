"""What lifter and controller would answer to the states of any bag, without a comparison.

The loop is open: the rig did not react to this theta. It shows how the controller would have begun
and where it would have turned, not where it would be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_identify.recording.signals import Signals
from koop_lab.replay.offline import OfflineLoop
from koop_lab.replay.plan import OWN_TOPICS, check_channels, given_values
from koop_loop import parameters
from koop_loop.parameters import LoopParameters


@dataclass(frozen=True)
class Answers:
    """Open-loop answers, one row a state; NaN in r where there is none."""

    r: NDArray[np.float64]
    theta: NDArray[np.float64]


def settings(
    dt: float,
    model: str | None = None,
    params: str | None = None,
    recorded: Mapping[str, Mapping[str, Any]] | None = None,
    lifted: bool | None = None,
) -> LoopParameters:
    """Return the parameters of an open-loop replay; other values are defaults.

    Parameters
    ----------
    dt : float
        Time between two states [s].
    model : str, optional
        Model file.
    params : str, optional
        ROS 2 parameter file.
    recorded : mapping, optional
        Recorded parameters by node, which the others win over.
    lifted : bool, optional
        Whether there is a model, without which the cost is raw; default: whether one is named.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used, or the lifted cost has no model of this dt.
    """
    known = recorded or {}
    values = {
        node: {"dt": dt, **known.get(node, {}), **given, **OWN_TOPICS[node]}
        for node, given in given_values(params, model).items()
    }
    lifter = values["koopman_lifter"]
    if not ("model" in lifter if lifted is None else lifted):
        lifter["cost"] = "raw"
    made = parameters.make(values)
    made.load_model()
    if made.esc.dt != made.lifter.dt or made.lifter.dt != dt:
        raise ConfigError(
            f"dt differs: states {dt:g} s, lifter {made.lifter.dt:g} s, controller {made.esc.dt:g}"
        )
    return made


def answer(signals: Signals, made: LoopParameters, what: str) -> Answers:
    """Answer the states of a recording, as nodes that join the rig would.

    Parameters
    ----------
    signals : Signals
        States with their steps.
    made : LoopParameters
        Of lifter and controller.
    what : str
        Where the states are from, for an error.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the model is for another number of channels.
    """
    model = made.load_model() if made.lifter.cost == "lifted" else None
    check_channels(model, signals.x.shape[1], what)
    nothing = np.zeros(signals.step.size, np.bool_)
    x = np.ascontiguousarray(signals.x)
    return Answers(*OfflineLoop(made).answer(made, signals.step, x, nothing, nothing))


def count_turns(theta: NDArray[np.float64]) -> int:
    """Return how often theta changes its direction."""
    moves = np.sign(np.diff(theta))
    return int(np.count_nonzero(np.diff(moves[moves != 0.0])))


def describe(signals: Signals, made: LoopParameters, answers: Answers) -> list[str]:
    """Return in words what the controller would have said."""
    lifter, esc = made.lifter, made.esc
    model = made.load_model() if lifter.cost == "lifted" else None
    kind = lifter.cost if model is None else model.provenance.get("variant", "lifted")
    usable = np.isfinite(answers.r)
    lines = [
        "OPEN LOOP: what lifter and controller would have said to these states; the rig did not "
        "react to this theta, and nothing recorded is compared",
        f"cost {kind}" + (f" of model {model.model_id}" if model is not None else "")
        + f", omega_h {lifter.omega_h:g}, omega_l {lifter.omega_l:g} rad/s; tau_f {esc.tau_f:g}, "
        f"dwell {esc.dwell:g} s, theta from {esc.theta_initial:g}",
        f"r      usable for {np.count_nonzero(usable)} of {usable.size} states",
    ]  # fmt: skip
    if usable.any():
        known = answers.r[usable]
        low, middle, high = np.quantile(known, (0.0, 0.5, 1.0))
        lines[-1] += f": least {low:.6g}, median {middle:.6g}, largest {high:.6g}"
    lines.append(
        f"theta  would have gone from {answers.theta[0]:.6g} to {answers.theta[-1]:.6g} "
        f"with {count_turns(answers.theta)} turns"
    )
    if signals.has_theta:
        known = signals.theta[np.isfinite(signals.theta)]
        lines.append(
            f"theta  recorded: from {known[0]:.6g} to {known[-1]:.6g}, {count_turns(known)} turns"
        )
    return lines


def write(path: Path, signals: Signals, answers: Answers) -> None:
    """Write states and answers as `.npz`."""
    with open(path, "wb") as file:
        np.savez(
            file,
            step=signals.step,
            t=signals.t,
            **dict(zip(signals.names, signals.x.T, strict=True)),
            recorded_theta=signals.theta,
            open_loop_r=answers.r,
            open_loop_theta=answers.theta,
        )
