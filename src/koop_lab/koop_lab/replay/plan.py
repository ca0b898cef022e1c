"""With what a recording is replayed: its own parameters and model, or the user's in their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_identify.recording.recorded_parameters import CONTROLLER, Change, Models, known_parameters
from koop_lab.replay.recording import Recording
from koop_lab.replay.unheard import joined_at, unheard_costs
from koop_loop import parameters
from koop_loop.parameters import LoopParameters
from koopman_lifter.model import KoopmanModel

Values = dict[str, dict[str, Any]]
OWN_TOPICS = {"koopman_lifter": {"input_fields": ""}, "relay_esc": {"command_topic": ""}}
"""A rig with messages of its own: what the lifter made of them is recorded as `state`."""


@dataclass(frozen=True)
class Stretch:
    """States `begin` to `end` (exclusive), answered with the same parameters.

    Attributes
    ----------
    begin, end : int
        Rows of the recording.
    parameters : LoopParameters
        Of the lifter and the controller; the plant's are defaults.
    changed : tuple of Change
        What was set before the first of these states.
    """

    begin: int
    end: int
    parameters: LoopParameters
    changed: tuple[Change, ...]


@dataclass(frozen=True)
class Plan:
    """Everything that decides on the answers, besides the states.

    Attributes
    ----------
    stretches : tuple of Stretch
        They follow on each other and cover the recording.
    differences : list of tuple
        (parameter, recorded, replayed) where the user's choice differs from the recording.
    notes : list of str
        What the user should know about the parameters.
    unheard : ndarray of bool, shape (M,)
        Whose costs the controller did not hear.
    """

    stretches: tuple[Stretch, ...]
    differences: list[tuple[str, Any, Any]]
    notes: list[str]
    unheard: NDArray[np.bool_]


def make_plan(recording: Recording, params: str | None = None, model: str | None = None) -> Plan:
    """Combine the recorded parameters with the user's.

    Parameters
    ----------
    recording : Recording
        The recording.
    params : str, optional
        ROS 2 parameter file; what it gives takes the place of the recorded values.
    model : str, optional
        Model file to use throughout.

    Raises
    ------
    ValueError
        If a parameter or a model cannot be used.
    """
    given = given_values(params, model)
    notes, recorded = _known(recording.values)
    first = recording.first_model
    named = [recorded["koopman_lifter"], *(change.values for change in recording.changes)]
    models = Models(recording.path, *(str(values.get("model", "")) for values in named))
    if lacking := recording.without_parameters:
        notes.append(
            f"the bag contains no parameters of {' and '.join(lacking)}: the defaults are assumed "
            "to be the recorded ones"
        )
    notes += [
        f"{name} was changed while recording; what it was before is not in the bag, and it is "
        "taken to have had the later value from the start"
        for name in recording.unknown
    ]
    if recording.first_cost:
        recorded["koopman_lifter"]["cost"] = recording.first_cost
    changes = tuple(_without(change, given[change.node]) for change in recording.changes)
    if first and "model" not in given["koopman_lifter"]:
        recorded["koopman_lifter"]["model"] = str(models.file(first))
        changes = tuple(_with_model(change, recording, models) for change in changes)
    elif first:
        recorded["koopman_lifter"]["model"] = ""
    used = {node: {**recorded[node], **given[node], **OWN_TOPICS[node]} for node in CONTROLLER}
    stretches = _stretches(used, changes, recording.step.size)
    recorded_loop = parameters.make(recorded)
    before = recorded_loop.as_ros()
    differences = []
    for node in CONTROLLER:
        after = stretches[0].parameters.as_ros()[node]
        for name in given[node]:
            if name != "model" and after[name] != before[node][name]:
                differences.append((f"{node}.{name}", before[node][name], after[name]))
    used_model = stretches[0].parameters.load_model()
    now = used_model.model_id if used_model is not None else "none"
    if now != first and any(item.parameters.lifter.cost == "lifted" for item in stretches):
        check_channels(used_model, recording.channels, f"the state in {recording.path}")
    if first and now != first:
        differences.append(("koopman_lifter.model", first, now))
    step_size = max(
        recorded_loop.esc.step_size, *(item.parameters.esc.step_size for item in stretches)
    )
    has_r, has_theta = recording.has_r, recording.has_theta
    u = recording.theta if recorded_loop.esc.theta_scale == "linear" else np.log(recording.theta)
    unheard = unheard_costs(has_r, has_theta, u, step_size)
    held = recording.hold | ~np.isfinite(recording.r)
    settling = recorded_loop.esc.params().settling
    joined = joined_at(has_r, has_theta, held, recording.theta, settling)
    if joined is not None:
        unheard[:joined] = has_r[:joined]
        notes.append(
            f"the controller joined at step {recording.step[joined]}, where its first theta is"
        )
    return Plan(stretches, differences, notes, unheard)


def given_values(params: str | None, model: str | None) -> Values:
    """Return the user's values of the lifter and the controller.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used.
    """
    given = parameters.read(params) if params else {}
    if model is not None:
        given.setdefault("koopman_lifter", {})["model"] = model
    parameters.make({node: given.get(node, {}) for node in CONTROLLER})  # names what is wrong
    return {node: dict(given.get(node, {})) for node in CONTROLLER}


def check_channels(model: KoopmanModel | None, n: int, what: str) -> None:
    """Raise ConfigError unless a model is for states of n channels; None is for any.

    Parameters
    ----------
    model : KoopmanModel or None
        The model.
    n : int
        Channels of the states.
    what : str
        Where the states are from.
    """
    if model is not None and model.delays.channels != n:
        wanted = model.delays.channels
        raise ConfigError(
            f"model {model.model_id} is for {wanted} channel{'s' * (wanted > 1)} "
            f"({', '.join(model.state_names)}); {what} has {n}"
        )


def _known(recorded: Values) -> tuple[list[str], Values]:
    """Leave out recorded parameters that this version does not have."""
    notes, kept = [], {}
    for node in CONTROLLER:
        known, values = known_parameters(node), recorded.get(node, {})
        kept[node] = {name: value for name, value in values.items() if name in known}
        kept[node].update(OWN_TOPICS[node])
        notes += [
            f"{node}.{name} = {value} was recorded; this version has no such parameter"
            for name, value in values.items()
            if name not in known
        ]
    return notes, kept


def _without(change: Change, given: Mapping[str, Any]) -> Change:
    """Leave out of a recorded change what the user has set for the whole replay."""
    known = known_parameters(change.node)
    kept = {k: v for k, v in change.values.items() if k in known and k not in given}
    return replace(change, values=kept)


def _with_model(change: Change, recording: Recording, models: Models) -> Change:
    """Replace the path in a change of model, which may be another machine's, by a file at hand."""
    if "model" not in change.values:
        return change
    path = str(models.file(str(recording.model[change.index])))
    return replace(change, values={**change.values, "model": path})


def _stretches(used: Values, changes: Iterable[Change], size: int) -> tuple[Stretch, ...]:
    at: dict[int, list[Change]] = {0: []}
    for change in changes:
        if change.values:
            at.setdefault(change.index, []).append(change)
    begins = sorted(at)
    stretches = []
    for begin, end in zip(begins, [*begins[1:], size], strict=True):
        for change in at[begin]:
            used = {**used, change.node: {**used[change.node], **change.values}}
        made = parameters.make(used)
        made.load_model()
        if made.lifter.dt != made.esc.dt:
            raise ConfigError(f"dt differs: lifter {made.lifter.dt}, controller {made.esc.dt} s")
        stretches.append(Stretch(begin, end, made, tuple(at[begin])))
    return tuple(stretches)
