"""Parameters and model of a recorded run, and the changes that were made while it ran."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_core.config.parameter import ListenersConfig, NodeConfig
from koop_core.config.parameter_file import ROS_OWN
from koop_core.errors import InputError
from koop_loop.parameters import names_of
from koopman_lifter.config import SOURCES, shipped_model
from koopman_lifter.model import ModelError, load

CONTROLLER = ("koopman_lifter", "relay_esc")
EVENTS = "/parameter_events"


@dataclass(frozen=True)
class ParameterChange:
    """Parameters of one node that were set while recording."""

    index: int
    """Row of the first state that was answered with them."""
    node: str
    values: dict[str, Any]
    """The new ones; an equal one counts too, for setting `cost` or `model` restarts the detector.
    """


def recorded_values(
    bag: BagReader, namespace: str, nodes: Iterable[str] = CONTROLLER
) -> dict[str, dict[str, Any]]:
    """Return the recorded parameters of some nodes; a node that has none is left out."""
    names = {node: f"{namespace.rstrip('/')}/{node}" for node in nodes}
    return {
        node: _loop_parameters(bag.parameters[name])
        for node, name in names.items()
        if name in bag.parameters
    }


def _loop_parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out what belongs to ROS or to the process and says nothing about the controller."""
    process = names_of((ListenersConfig, NodeConfig))
    return {k: v for k, v in values.items() if k not in process and not k.startswith(ROS_OWN)}


def recorded_changes(
    bag: BagReader,
    namespace: str,
    answered: Mapping[str, NDArray[Any]],
    source: NDArray[Any],
    model: NDArray[np.str_],
) -> tuple[ParameterChange, ...]:
    """Return what was changed between two answers.

    A node sends an event about the change and its answers from one thread, so that the times of
    sending put them in order: ``answered`` says by node, shape (M,), when its answers were sent
    [ns]; 0 where there is none. The recorded source, above 1 where there is none, and model of the
    cost, shape (M,), say when it was switched where the event of that was not recorded.
    """
    changes: list[ParameterChange] = []
    names = {number: name for name, number in SOURCES.items()}
    recorded = any(topic.name == EVENTS and topic.count for topic in bag.topics)
    for event in _events(bag, namespace) if recorded else ():
        later = np.flatnonzero(answered[event.node] > event.sent)
        if event.changed and later.size:
            changes.append(ParameterChange(int(later[0]), event.node, event.changed))
    switched = {change.index for change in changes if {"cost", "model"} & set(change.values)}
    for before, k in pairwise(np.flatnonzero(source < len(names)).tolist()):
        if k in switched or (source[k], model[k]) == (source[before], model[before]):
            continue
        values = {"cost": names[int(source[k])]}
        if model[k] != model[before]:
            values["model"] = str(model[k])
        changes.append(ParameterChange(k, "koopman_lifter", values))
    return tuple(sorted(changes, key=lambda change: change.index))


def first_values(
    bag: BagReader,
    namespace: str,
    collected: Mapping[str, Mapping[str, Any]],
    changes: Iterable[ParameterChange],
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Return the parameters at the first state, and the names of those that are not in the bag.

    The recorder asks every node once, perhaps after a change. What a changed parameter was before
    is known from the event that announced it; which cost and model it was, from the first answer.
    """
    values = {node: dict(items) for node, items in collected.items()}
    changed = {(change.node, name): value for change in changes
               for name, value in change.values.items()}  # fmt: skip
    declared: dict[tuple[str, str], Any] = {}
    later: set[tuple[str, str]] = set()  # a node that begins again announces what was changed
    if changed and any(topic.name == EVENTS for topic in bag.topics):
        for event in _events(bag, namespace):
            for name, value in event.declared.items():
                if (event.node, name) not in later:
                    declared.setdefault((event.node, name), value)
            later |= {(event.node, name) for name in event.changed}
    unknown = []
    for (node, name), value in changed.items():
        if (node, name) in declared:
            values.setdefault(node, {})[name] = declared[node, name]
        elif name not in ("cost", "model") and values.get(node, {}).get(name) == value:
            unknown.append(f"{node}.{name}")
    return values, unknown


class _Event(NamedTuple):
    """A rcl_interfaces/ParameterEvent of the lifter or the controller."""

    sent: int
    node: str
    declared: dict[str, Any]
    changed: dict[str, Any]


def _events(bag: BagReader, namespace: str) -> Iterator[_Event]:
    decode = decoder(bag, EVENTS)
    nodes = {f"{namespace.rstrip('/')}/{node}": node for node in CONTROLLER}
    for message in bag.messages([EVENTS]):
        event = decode(message.data)
        if event.node in nodes:
            node = nodes[event.node]
            declared, changed = (
                _loop_parameters({item.name: _value(item.value) for item in items})
                for items in (event.new_parameters, event.changed_parameters)
            )
            yield _Event(message.publish_time, node, declared, changed)


def decoder(bag: BagReader, name: str) -> Callable[[bytes], Any]:
    """Return what makes messages of a topic out of their bytes."""
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    topic = bag.topic(name)
    schema = Schema(id=1, name=topic.type_name, encoding="ros2msg", data=topic.definition.encode())
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    return decode


def _value(value: Any) -> Any:
    """Return what a rcl_interfaces/ParameterValue holds."""
    kinds = ("bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array",
             "double_array", "string_array")  # fmt: skip
    if not 1 <= value.type <= len(kinds):
        return None
    held = getattr(value, f"{kinds[value.type - 1]}_value")
    return list(held) if kinds[value.type - 1].endswith("array") else held


class Models:
    """The model files at hand, by the id that recordings refer to them by.

    The folder `model/` of the bag or the run is searched first, then the candidates: files that the
    recorded parameters name.
    """

    def __init__(self, path: Path, *candidates: str) -> None:
        self._files: dict[str, Path] = {}
        folders = [Path(path) / "model", Path(path).parent / "model"]
        files = [file for folder in folders for file in sorted(folder.glob("*.npz"))]
        for file in (*files, *(Path(name).expanduser() for name in candidates), shipped_model()):
            try:
                self._files.setdefault(load(file).model_id, file)
            except ModelError:
                continue  # a path of another machine; whether it matters shows when it is looked up

    def file(self, model_id: str) -> Path:
        """Return the file of a model.

        Raises
        ------
        koop_core.errors.InputError
            If it is not at hand.
        """
        if model_id not in self._files:
            raise InputError(
                f"the recording was made with model {model_id}, which is not in its folder; "
                "give the file with --model"
            )
        return self._files[model_id]
