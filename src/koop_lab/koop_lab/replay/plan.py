"""With what a recording is replayed: its own parameters and model, or the user's in their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_identify.recording.recorded_parameters import (
    CONTROLLER,
    Models,
    ParameterChange,
    known_parameters,
)
from koop_lab.replay.recording import Recording
from koop_lab.replay.unheard import find_join, unheard_costs
from koop_loop import parameters
from koop_loop.parameters import LoopParameters
from koopman_lifter.model import KoopmanModel

Values = dict[str, dict[str, Any]]
OWN_TOPICS = {"koopman_lifter": {"measured": ""}, "relay_esc": {"command": ""}}
"""A rig with messages of its own: what the lifter made of them is recorded as `state`."""


@dataclass(frozen=True)
class ReplaySegment:
    """States `begin` to `end` (exclusive), answered with the same parameters.

    Attributes
    ----------
    begin, end : int
        Rows of the recording.
    parameters : LoopParameters
        Parameters of the lifter and the controller; the plant's are defaults.
    changed : tuple of ParameterChange
        What was set before the first of these states.
    """

    begin: int
    end: int
    parameters: LoopParameters
    changed: tuple[ParameterChange, ...]


@dataclass(frozen=True)
class ReplayPlan:
    """Everything that decides the answers, besides the states.

    Attributes
    ----------
    segments : tuple of ReplaySegment
        Consecutive parts that cover the recording.
    differences : list of tuple
        (parameter, recorded, replayed) where the user's choice differs from the recording.
    notes : list of str
        What the user should know about the parameters.
    unheard : ndarray of bool, shape (M,)
        States whose costs the controller did not hear.
    """

    segments: tuple[ReplaySegment, ...]
    differences: list[tuple[str, Any, Any]]
    notes: list[str]
    unheard: NDArray[np.bool_]


def make_plan(
    recording: Recording, params: str | None = None, model: str | None = None
) -> ReplayPlan:
    """Combine the recorded parameters with the user's.

    Parameters
    ----------
    recording : Recording
        The recording.
    params : str, optional
        ROS 2 parameter file; its values take the place of the recorded ones.
    model : str, optional
        Model file to use throughout.

    Raises
    ------
    koop_core.errors.InputError
        If a parameter or a model cannot be used.
    """
    chosen = given_values(params, model)
    notes, recorded = _usable_values(recording)
    changes = tuple(_without(change, chosen[change.node]) for change in recording.changes)
    if recording.first_model:
        recorded["koopman_lifter"]["model"] = ""
        if "model" not in chosen["koopman_lifter"]:
            named = [recording.values.get("koopman_lifter", {}), *(c.values for c in changes)]
            models = Models(recording.path, *(str(values.get("model", "")) for values in named))
            recorded["koopman_lifter"]["model"] = str(models.file(recording.first_model))
            changes = tuple(_with_model(change, recording, models) for change in changes)
    used = {node: {**recorded[node], **chosen[node], **OWN_TOPICS[node]} for node in CONTROLLER}
    segments = _segments(used, changes, recording.step.size)
    before = parameters.make(recorded)
    differences = _differences(before, segments[0].parameters, chosen)
    differences += _model_difference(recording, segments)
    unheard, joined = _find_unheard(recording, before, segments)
    if joined is not None:
        notes.append(
            f"the controller joined at step {recording.step[joined]}, where its first theta is"
        )
    return ReplayPlan(segments, differences, notes, unheard)


def _usable_values(recording: Recording) -> tuple[list[str], Values]:
    """Return notes, and the recorded parameters that this version has."""
    notes: list[str] = []
    usable: Values = {}
    for node in CONTROLLER:
        names, values = known_parameters(node), recording.values.get(node, {})
        usable[node] = {name: value for name, value in values.items() if name in names}
        usable[node].update(OWN_TOPICS[node])
        notes += [
            f"{node}.{name} = {value} was recorded; this version has no such parameter"
            for name, value in values.items()
            if name not in names
        ]
    if recording.first_cost:
        usable["koopman_lifter"]["cost"] = recording.first_cost
    if lacking := recording.without_parameters:
        notes.append(
            f"the bag contains no parameters of {' and '.join(lacking)}: the defaults are assumed "
            "to be the recorded ones"
        )
    notes += [
        f"{name} was changed while recording; its earlier value is not in the bag, and the later "
        "one is assumed from the start"
        for name in recording.unknown
    ]
    return notes, usable


def _differences(
    recorded: LoopParameters, replayed: LoopParameters, chosen: Values
) -> list[tuple[str, Any, Any]]:
    """Return the user's values that differ from the recorded ones, but for the model."""
    before, after = recorded.as_ros(), replayed.as_ros()
    return [
        (f"{node}.{name}", before[node][name], after[node][name])
        for node in CONTROLLER
        for name in chosen[node]
        if name != "model" and after[node][name] != before[node][name]
    ]


def _model_difference(
    recording: Recording, segments: tuple[ReplaySegment, ...]
) -> list[tuple[str, Any, Any]]:
    """Return the difference between the recorded model and the replayed one, if there is one."""
    first, model = recording.first_model, segments[0].parameters.load_model()
    model_id = model.model_id if model is not None else "none"
    if model_id == first:
        return []
    if any(segment.parameters.lifter.cost == "lifted" for segment in segments):
        check_channels(model, recording.channels, f"the state in {recording.path}")
    return [("koopman_lifter.model", first, model_id)] if first else []


def _find_unheard(
    recording: Recording, recorded: LoopParameters, segments: tuple[ReplaySegment, ...]
) -> tuple[NDArray[np.bool_], int | None]:
    """Return the costs that the controller did not hear, and the row with which it joined."""
    esc, has_r, has_theta = recorded.esc, recording.has_r, recording.has_theta
    u = recording.theta if esc.theta_scale == "linear" else np.log(recording.theta)
    sizes = [segment.parameters.esc.step_size for segment in segments]
    unheard = unheard_costs(has_r, has_theta, u, max(esc.step_size, *sizes))
    held = recording.hold | ~np.isfinite(recording.r)
    joined = find_join(has_r, has_theta, held, recording.theta, esc.params().settling)
    if joined is not None:
        unheard[:joined] = has_r[:joined]
    return unheard, joined


def given_values(params: str | None, model: str | None) -> Values:
    """Return the user's values of the lifter and the controller.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used.
    """
    values = parameters.read(params) if params else {}
    if model is not None:
        values.setdefault("koopman_lifter", {})["model"] = model
    chosen = {node: dict(values.get(node, {})) for node in CONTROLLER}
    parameters.make(chosen)  # names what is wrong
    return chosen


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
        channels = model.delays.channels
        raise ConfigError(
            f"model {model.model_id} is for {channels} channel{'s' * (channels > 1)} "
            f"({', '.join(model.state_names)}); {what} has {n}"
        )


def _without(change: ParameterChange, chosen: Mapping[str, Any]) -> ParameterChange:
    """Leave out of a recorded change what the user has set for the whole replay."""
    names = known_parameters(change.node) - chosen.keys()
    return replace(change, values={k: v for k, v in change.values.items() if k in names})


def _with_model(change: ParameterChange, recording: Recording, models: Models) -> ParameterChange:
    """Replace the path in a change of model, which may be another machine's, by a file at hand."""
    if "model" not in change.values:
        return change
    path = str(models.file(str(recording.model[change.index])))
    return replace(change, values={**change.values, "model": path})


def _segments(
    used: Values, changes: Iterable[ParameterChange], size: int
) -> tuple[ReplaySegment, ...]:
    at: dict[int, list[ParameterChange]] = {0: []}
    for change in changes:
        if change.values:
            at.setdefault(change.index, []).append(change)
    begins = sorted(at)
    segments = []
    for begin, end in zip(begins, [*begins[1:], size], strict=True):
        for change in at[begin]:
            used = {**used, change.node: {**used[change.node], **change.values}}
        loop = parameters.make(used)
        loop.load_model()
        if loop.lifter.dt != loop.esc.dt:
            raise ConfigError(f"dt differs: lifter {loop.lifter.dt}, controller {loop.esc.dt} s")
        segments.append(ReplaySegment(begin, end, loop, tuple(at[begin])))
    return tuple(segments)
