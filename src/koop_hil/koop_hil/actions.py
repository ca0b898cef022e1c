"""Actions on the loop of a scenario: how each is checked, done and undone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from koop_core.config.parameter import ConfigError, mapping
from koop_hil import faults
from koop_identify.recording.recorded_parameters import CONTROLLER

NODES = ("plant", *CONTROLLER)
ACTIONS = ("inject", "kill", "pause", "set", "cut")
PUBLISHING = ("kill", "cut")
"""Actions after which topics have more publishers for a while than usual."""


def number(value: Any, name: str) -> float:
    """Return a number; raise ConfigError if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e15 < value < 1e15:
        raise ConfigError(f"{name}: {value!r} is not a number")
    return float(value)


def check(action: str, what: Any, folder: Path) -> Any:
    """Return what an event is about as it is used; raise ConfigError if it means nothing."""
    match action:
        case "inject":
            for topic, text in mapping(what, "inject").items():
                if topic not in ("state", "theta"):
                    raise ConfigError(f"inject: into state or theta, not '{topic}'")
                if not isinstance(text, str):
                    raise ConfigError(f"inject: {topic}: {text!r} is not text: quote 'off' in YAML")
                faults.parse(text)
        case "set":
            what = {node: mapping(values, "set") for node, values in mapping(what, "set").items()}
            for values in what.values():
                if "model" in values:
                    values["model"] = str((folder / str(values["model"])).resolve())
        case "cut" if what != "link":
            raise ConfigError(f"cut: link, not {what!r}")
        case "kill" | "pause" if what not in NODES:
            raise ConfigError(f"{action}: one of {', '.join(NODES)}, not {what!r}")
    return what


def act(loop: Any, action: str, what: Any, over: bool) -> None:
    """Do it to a :class:`koop_hil.processes.Processes`, or undo it when the event is over."""
    match action:
        case "inject":
            values = {f"{topic}_fault": "ok" if over else fault for topic, fault in what.items()}
            loop.monitor.set_parameters("fault_injector", values)
        case "kill":
            (loop.start if over else loop.kill)(what)
        case "pause":
            loop.pause(what, not over)
        case "set" if not over:
            for node, values in what.items():
                loop.monitor.set_parameters(node, values)
        case "cut":
            loop.link(up=over)
