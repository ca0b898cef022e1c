"""With what a recording is replayed: its own parameters and model, or the user's in their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from koop_identify.recording.recorded_parameters import (
    CONTROLLER,
    Models,
    ParameterChange,
)
from koop_lab.replay.recording import Recording
from koop_loop import parameters
from koop_loop.parameters import NODES, LoopParameters, names_of
from koopman_lifter.model import load_fitting

Values = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class ReplaySegment:
    """States `begin` to `end` (exclusive), answered with the same parameters."""

    begin: int
    end: int
    """Rows of the recording."""
    parameters: LoopParameters
    """Parameters of the lifter and the controller; the plant's are defaults."""
    changed: tuple[ParameterChange, ...]
    """What was set before the first of these states."""


@dataclass(frozen=True)
class ReplayPlan:
    """Everything that decides the answers, besides the states."""

    segments: tuple[ReplaySegment, ...]
    """Consecutive parts that cover the recording."""
    differences: list[tuple[str, Any, Any]]
    """(parameter, recorded, replayed) where the user's choice differs from the recording."""
    notes: list[str]
    """What the user should know about the parameters."""


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
    file_values = parameters.read(params) if params else {}
    chosen = {node: dict(file_values.get(node, {})) for node in CONTROLLER}
    if model is not None:
        chosen["koopman_lifter"]["model"] = model
    parameters.make(chosen)  # names what is wrong
    notes, recorded = _usable_values(recording)
    changes = tuple(_without(change, chosen[change.node]) for change in recording.changes)
    if recording.first_model:
        recorded["koopman_lifter"]["model"] = ""
        if "model" not in chosen["koopman_lifter"]:
            named = [recording.values.get("koopman_lifter", {}), *(c.values for c in changes)]
            models = Models(recording.path, *(str(values.get("model", "")) for values in named))
            recorded["koopman_lifter"]["model"] = str(models.file(recording.first_model))
            changes = tuple(_with_model(change, recording, models) for change in changes)
    used = {node: {**recorded[node], **chosen[node]} for node in CONTROLLER}
    used["koopman_lifter"]["measured"] = ""
    segments = _segments(used, changes, recording.step.size)
    differences = _differences(recording, parameters.make(recorded), segments, chosen)
    return ReplayPlan(segments, differences, notes)


def _usable_values(recording: Recording) -> tuple[list[str], Values]:
    """Return notes, and the recorded parameters that this version has."""
    notes: list[str] = []
    usable: Values = {}
    for node in CONTROLLER:
        names, values = names_of(NODES[node]), recording.values.get(node, {})
        usable[node] = {name: value for name, value in values.items() if name in names}
        notes += [
            f"{node}.{name} = {value} was recorded; this version has no such parameter"
            for name, value in values.items()
            if name not in names
        ]
    usable["koopman_lifter"]["measured"] = ""  # a rig's own message is recorded as `state`
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
    recording: Recording,
    recorded: LoopParameters,
    segments: tuple[ReplaySegment, ...],
    chosen: Values,
) -> list[tuple[str, Any, Any]]:
    """Return the user's values, and the model, where they differ from the recorded ones.

    What a node reads once at its start, such as `listeners`, decides no answer.
    """
    before, after = recorded.as_ros(), segments[0].parameters.as_ros()
    differences = [
        (f"{node}.{name}", before[node][name], after[node][name])
        for node in CONTROLLER
        for name in chosen[node]
        if name in after[node] and name != "model" and after[node][name] != before[node][name]
    ]
    first, loop = recording.first_model, segments[0].parameters
    model = loop.load_model()
    model_id = model.model_id if model is not None else "none"
    if model_id == first:
        return differences
    if any(segment.parameters.lifter.cost == "lifted" for segment in segments):
        load_fitting(loop.model.path, loop.lifter.dt, recording.channels)
    return [*differences, ("koopman_lifter.model", first, model_id)] if first else differences


def _without(change: ParameterChange, chosen: Mapping[str, Any]) -> ParameterChange:
    """Leave out of a recorded change what the user has set for the whole replay."""
    names = names_of(NODES[change.node]) - chosen.keys()
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
        segments.append(ReplaySegment(begin, end, loop, tuple(at[begin])))
    return tuple(segments)
