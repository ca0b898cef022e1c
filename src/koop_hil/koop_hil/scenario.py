"""Scenario files: a plant, events in the loop, and limits that must hold afterwards."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config import objects
from koop_core.config.fields import parse_source
from koop_core.config.knobs import KnobSettings
from koop_core.config.parameter import ConfigError, Settings, mapping, parameter, refuse_unknown
from koop_core.config.yaml_file import read_yaml
from koop_hil import installed
from koop_hil.actions import ACTIONS, NODES, check, number
from koop_identify.recording.recorded_parameters import CONTROLLER
from koop_loop import parameters
from vdp_plant.config import PlantConfig

NO_LIMIT = 1e9
RIGS = ("galloping", "inverter", "jsbsim", "other", "paper")  # of koop_hil/rigs


@dataclass(frozen=True)
class ScenarioEvent:
    """Something that happens to the loop."""

    at: float
    lasts: float
    """Begin and length [s] of simulated time."""
    action: str
    """One of :data:`koop_hil.actions.ACTIONS`."""
    what: Any
    """``{topic: fault}``, a node, ``{node: {parameter: value}}`` or ``link``."""

    def __str__(self) -> str:
        lasts = f" for {self.lasts:g} s" if self.lasts else ""
        return f"{self.action.replace('_', ' ')} {self.what}{lasts}"


@dataclass(frozen=True)
class Limits(Settings):
    """Limits that must hold at the end; theta is the value that acted on the plant."""

    tail_error: float = parameter(0.6, "mean |theta - theta*| over the last 30 %", low=0.0)
    max_error: float = parameter(NO_LIMIT, "largest |theta - theta*| from the first event on")
    error_limit: float = parameter(
        1.5, "|theta - theta*| out of tolerance; the relay's own cycle is 1", low=0.0
    )
    answer_age: float = parameter(
        NO_LIMIT, "real age of a state when the answer to it begins to act", unit="s"
    )
    covered: float = parameter(0.3, "least share of the duration for which theta is known")
    unrecorded: int = parameter(
        0, "messages that the recording may lack: those under way when a node was killed"
    )


@dataclass(frozen=True)
class Setting(KnobSettings):
    """Plant and speed of a scenario."""

    description: str = parameter("", "purpose of the scenario")
    plant: str = parameter("vdp_plant", "vdp_plant, or the name of a rig (koop_hil/rigs)")
    rig_options: str = parameter("", "further options of the rig, such as --at 60:throttle=1")
    theta_star: float = parameter(
        -3.0, "optimal theta, at the end", low=-1e3, high=1e3, per_knob=True
    )
    time_scale: float = parameter(
        1.0, "simulated per real time; 1 is real time", low=0.01, high=1e3
    )
    duration: float = parameter(
        60.0, "simulated time from the first state", unit="s", low=1.0, high=1e5
    )
    theta_initial: float = parameter(
        2.0, "theta at the start", low=-100.0, high=100.0, per_knob=True
    )
    model: str = parameter("", "model file, relative to the scenario; empty: the shipped one")
    remote: str = parameter("", "what runs on another host; empty: nothing", choices=("", *NODES))


@dataclass(frozen=True)
class Scenario:
    """One scenario file."""

    name: str
    setting: Setting
    parameters: dict[str, dict[str, Any]]
    events: tuple[ScenarioEvent, ...]
    limits: Limits
    levels: dict[str, str]

    @property
    def injects(self) -> bool:
        """Whether a fault injector stands between plant and controller."""
        return any(event.action == "inject" for event in self.events)

    @property
    def topics(self) -> list[str]:
        """Topics of its loop, each with one publisher."""
        names = ["state", "cost", "theta", "ground_truth"]
        names += ["rig/state", "rig/theta"] if self.injects else []
        return [*names, self.sensor_topic] if self.sensor_topic else names

    @property
    def sensor_topic(self) -> str:
        """Where the plant measures if the lifter picks fields of it; else empty."""
        fields = self.parameters.get("koopman_lifter", {}).get("measured", "")
        return parse_source(fields).topic.lstrip("/") if fields else ""

    @property
    def dt(self) -> float:
        """Time between two states [s]."""
        return float(self.parameters.get("koopman_lifter", {}).get("dt", PlantConfig().dt))

    def off(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far each theta, shape (M, n), is from its optimum; of the worst knob, (M,).

        In Np where the law seeks in ln theta.
        """
        best = np.array(self.setting.each("theta_star"))
        logarithmic = self.parameters.get("relay_esc", {}).get("theta_scale") == "log"
        way = np.log(theta / best) if logarithmic else theta - best
        return np.asarray(np.abs(way).max(axis=1))


def shipped() -> list[Path]:
    """Return the scenario files that come with the package."""
    return sorted(installed("scenarios").glob("*.yaml"))


def find(name: str) -> Path:
    """Return the file of a scenario, given as a file or by the name of a shipped one.

    Raises ConfigError if there is none.
    """
    if Path(name).suffix in (".yaml", ".yml"):
        return Path(name)
    for path in shipped():
        if path.stem == name:
            return path
    raise ConfigError(f"no scenario '{name}': 'koop hil --list' shows them")


def read(path: Path) -> Scenario:
    """Read a scenario file.

    Raises ConfigError if it cannot be read or says something meaningless; names file and entry.
    """
    content = read_yaml(path)
    try:
        return parse(path.stem, content, path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def parse(name: str, content: Any, folder: Path) -> Scenario:
    """Return the scenario that the content of a file describes."""
    top = mapping(content, "a scenario")
    setting_names = {item.name for item in fields(Setting)}
    keys = {"parameters", "events", "limits", "levels"}
    refuse_unknown(top, sorted(setting_names | keys), "key", "a scenario")
    settings = {key: value for key, value in top.items() if key in setting_names}
    if settings.get("model"):
        settings["model"] = str((folder / str(settings["model"])).resolve())
    limits = objects.parse(Limits, top.get("limits", {}), "limits")
    sections = mapping(top.get("parameters", {}), "parameters")
    by_node = {str(node): mapping(values, str(node)) for node, values in sections.items()}
    setting = Setting(**settings)
    begin = {"theta_initial": setting.theta_initial, **by_node.get("relay_esc", {})}
    parameters.build({node: by_node.get(node, {}) for node in CONTROLLER} | {"relay_esc": begin})
    events = top.get("events", [])
    if not isinstance(events, list):
        raise ConfigError("events must be a list")
    levels = mapping(top.get("levels", {}), "levels")
    for node, level in levels.items():
        if level not in ("WARN", "ERROR", "STALE"):
            raise ConfigError(f"levels: {node} must be WARN, ERROR or STALE")
    if setting.plant not in (plants := ("vdp_plant", *RIGS)):
        raise ConfigError(f"plant = '{setting.plant}': must be one of {', '.join(plants)}")
    if setting.rig_options and setting.plant == "vdp_plant":
        raise ConfigError("rig_options: only of a rig: vdp_plant has parameters")
    happens = tuple(_event(item, folder) for item in events)
    if not setting.remote and any(event.action == "cut" for event in happens):
        raise ConfigError("cut: there is a link only if 'remote' names what runs on another host")
    scenario = Scenario(
        name,
        setting,
        by_node,
        happens,
        limits,
        {str(node): level for node, level in levels.items()},
    )
    if scenario.sensor_topic and scenario.injects:
        raise ConfigError("inject: between the plant's 'state' and the lifter, not measured")
    return scenario


def _event(item: Any, folder: Path) -> ScenarioEvent:
    entry = mapping(item, "an event")
    refuse_unknown(entry, ("at", "for", *ACTIONS), "key", "an event")
    actions = [key for key in entry if key in ACTIONS]
    if len(actions) != 1:
        raise ConfigError(f"an event has one of {', '.join(ACTIONS)}: {entry}")
    at, lasts = (number(entry.get(key, 0.0), key) for key in ("at", "for"))
    return ScenarioEvent(at, lasts, actions[0], check(actions[0], entry[actions[0]], folder))
