"""Actions on the loop of a scenario: how each is checked, begun and ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from koop_core.config.parameter import ConfigError, mapping
from koop_hil import faults
from koop_identify.recording.recorded_parameters import CONTROLLER

NODES = ("plant", *CONTROLLER)


class Action(NamedTuple):
    """One kind of event."""

    check: Callable[[Any, Path], Any]
    """Returns what the event is about as it is used, given it and the scenario's folder."""
    begin: Callable[[Any, Any], None]
    end: Callable[[Any, Any], None] = lambda loop, what: None
    """Do it, and undo it when the event is over, given the scenario's
    :class:`koop_hil.processes.Processes` and what it is about."""
    publishers: bool = False
    """Whether topics then have more publishers for a while than usual."""


def number(value: Any, name: str) -> float:
    """Return a number; raise ConfigError if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e15 < value < 1e15:
        raise ConfigError(f"{name}: {value!r} is not a number")
    return float(value)


def _one_of(action: str, *names: str) -> Callable[[Any, Path], Any]:
    def check(what: Any, folder: Path) -> Any:
        if what not in names:
            one = "one of " if len(names) > 1 else ""
            raise ConfigError(f"{action}: {one}{', '.join(names)}, not {what!r}")
        return what

    return check


def _check_faults(what: Any, folder: Path) -> Any:
    for topic, text in mapping(what, "inject").items():
        if topic not in ("state", "theta"):
            raise ConfigError(f"inject: into state or theta, not '{topic}'")
        if not isinstance(text, str):
            raise ConfigError(f"inject: {topic}: {text!r} is not text: quote 'off' in YAML")
        faults.parse(text)
    return what


def _check_parameters(what: Any, folder: Path) -> Any:
    nodes = {node: mapping(values, "set") for node, values in mapping(what, "set").items()}
    for values in nodes.values():
        if "model" in values:
            values["model"] = str((folder / str(values["model"])).resolve())
    return nodes


def _inject(loop: Any, what: dict[str, str]) -> None:
    _set(loop, {"fault_injector": {f"{topic}_fault": fault for topic, fault in what.items()}})


def _set(loop: Any, what: dict[str, dict[str, Any]]) -> None:
    for node, values in what.items():
        loop.monitor.set_parameters(node, values)


ACTIONS: dict[str, Action] = {
    "inject": Action(
        _check_faults, _inject, lambda loop, what: _inject(loop, dict.fromkeys(what, "ok"))
    ),
    "kill": Action(
        _one_of("kill", *NODES),
        lambda loop, what: loop.kill(what),
        lambda loop, what: loop.start(what),
        publishers=True,
    ),
    "pause": Action(
        _one_of("pause", *NODES),
        lambda loop, what: loop.pause(what, True),
        lambda loop, what: loop.pause(what, False),
    ),
    "set": Action(_check_parameters, _set),
    "cut": Action(
        _one_of("cut", "link"),
        lambda loop, what: loop.link(up=False),
        lambda loop, what: loop.link(up=True),
        publishers=True,
    ),
}
