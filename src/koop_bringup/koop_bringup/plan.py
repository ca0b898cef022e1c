"""Which nodes a launch starts, with which parameters. Pure: neither launch nor ROS is imported.

What is really given counts, in this order: an argument of the launch, the parameter file, the
node's own default. Everything is checked here, before the first node starts.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from platform import machine
from typing import Any, NamedTuple

from koop_bag.recorder.config import RECORDER, RecorderConfig
from koop_core.config import parameter_file
from koop_core.config.parameter import SIMILAR, ConfigError, refuse_unknown
from koop_core.config.parameter_file import ParameterFile
from koop_core.config.program import split_command
from koop_guard.config import ASKED, GUARD, THETA, GuardConfig
from koop_guard.note import note_of
from koop_loop.parameters import (
    COMPONENTS,
    CONTAINER,
    EXECUTABLES,
    NODES,
    RIG,
    RigConfig,
    build,
    names_of,
    with_model_beside,
)
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.model import load_for
from relay_esc.config import EscConfig
from vdp_plant.config import pace_values

ALL_NODES = {**NODES, **RECORDER, **GUARD}
FLAGS = ("true", "false", "True", "False")
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"  # Fast DDS's, in the environment


class Argument(NamedTuple):
    """An argument of the launch; an empty one is not given.

    Attributes
    ----------
    name, meaning : str
        What it is called and does.
    node : str
        The node whose parameter of that name it sets; empty if it is not a parameter.
    choices : tuple of str
        What it may be; empty: anything.
    kind : type
        Type of the parameter.
    """

    name: str
    meaning: str
    node: str = ""
    choices: tuple[str, ...] = ()
    kind: type = str


ARGUMENTS = (
    Argument("namespace", "namespace of the whole loop; a fleet is N namespaces"),
    Argument("params", "ROS 2 parameter file for all nodes; an argument wins over the file"),
    Argument("pace", "realtime, lockstep or a number: so many times real time", "vdp_plant"),
    Argument(
        "duration",
        "simulated time [s] after which the launch ends; 0: never",
        "vdp_plant",
        kind=float,
    ),
    Argument("seed", "seed of the plant's initial state", "vdp_plant", kind=int),
    Argument("cost", "lifted or raw", "koopman_lifter", ("lifted", "raw")),
    Argument("model", "Koopman model file", "koopman_lifter"),
    Argument(
        "plant",
        "true: start the simulated plant; false: your rig is the plant (true without a file, "
        "else whether the file has a section for vdp_plant)",
        choices=FLAGS,
    ),
    Argument(
        "record",
        "true: record all topics; the simulated plant waits for the recorder (false)",
        choices=FLAGS,
    ),
    Argument("output", "folder of the recording", "recorder"),
    Argument(
        "composed", "true: all nodes but the recorder share one process (false)", choices=FLAGS
    ),
)


class PlannedNode(NamedTuple):
    """A node to start, or several in a container.

    Attributes
    ----------
    name : str
        Name of the node; for a container, of the node by whose end the run is judged.
    package, executable : str
        Where to find it.
    arguments : tuple of str
        The components of a container.
    """

    name: str
    package: str
    executable: str
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Processes and parameters of a launch.

    Attributes
    ----------
    parameters : dict
        All that is given, by node, of those that are started.
    namespace : str
        Namespace of all nodes, such as ``/rig``; empty for the root.
    rig : bool
        Whether a rig is the plant.
    program : tuple of str
        The rig's own program with its arguments; empty: it is started by others.
    composed : bool
        Whether all nodes but recorder and guard share one process.
    remaps : tuple of str
        Topics of one node that have another name, as ``NODE:FROM:=TO``.
    notes : tuple of str
        What the user should know.
    """

    parameters: dict[str, dict[str, Any]]
    namespace: str = ""
    rig: bool = False
    program: tuple[str, ...] = ()
    composed: bool = False
    remaps: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def nodes(self) -> tuple[PlannedNode, ...]:
        """The nodes, in the order of starting."""
        names = [name for name in EXECUTABLES if name in self.parameters]
        return tuple(PlannedNode(name, *EXECUTABLES[name]) for name in names)

    def processes(self) -> tuple[PlannedNode, ...]:
        """Return what is started: a process a node, or one for all but recorder and guard."""
        if not self.composed:
            return self.nodes
        apart = tuple(node for node in self.nodes if node.name not in COMPONENTS)
        names = [node.name for node in self.nodes if node.name in COMPONENTS]
        components = tuple(COMPONENTS[name] for name in names)
        return (*apart, PlannedNode(names[-1], *CONTAINER, components))

    @property
    def journaled(self) -> bool:
        """Whether the composed nodes write for the recorder: :mod:`koop_core.journal`."""
        return self.composed and "recorder" in self.parameters and machine() in ("x86_64", "AMD64")

    @property
    def environment(self) -> dict[str, str]:
        """What is added to the environment of each node: those of a rig's loop receive by UDP.

        A mailbox in shared memory may be lost for good: its reader stood still or was killed.
        """
        return {TRANSPORTS: os.environ.get(TRANSPORTS, "UDPv4")} if self.rig else {}


def plan(texts: Mapping[str, str], shared: Mapping[str, Any] | None = None) -> Plan:
    """Return what a launch with these arguments does.

    Parameters
    ----------
    texts : mapping of str to str
        Arguments by name; an empty one is not given.
    shared : mapping of str to object, optional
        Parameters for all nodes that have them, whatever they are; file and arguments win.

    Raises
    ------
    KoopError
        If an argument, the parameter file or the model cannot be used; in one line.
    """
    arguments = {name: text for name, text in texts.items() if text}
    namespace = _namespace(arguments.get("namespace", ""))
    file = parameter_file.read(arguments["params"]) if "params" in arguments else None
    notes = []
    simulated, recorded = _flag("plant", arguments, True), _flag("record", arguments, False)
    if (
        file is not None
        and "plant" not in arguments
        and not file.describes(f"{namespace}/vdp_plant")
    ):
        simulated = False
        if not any(file.describes(f"{namespace}/{name}") for name in ("rig", "koop_guard")):
            notes.append(
                f"{file.path} has no section for vdp_plant: the loop runs on the rig "
                "(plant:=true: on the simulated plant)"
            )
    program = _program(file, namespace)
    if simulated and program:
        raise ConfigError(
            f"{arguments['params']}: names the simulated plant and the rig's own program: keep the "
            "section vdp_plant or rig.command"
        )
    guarded = not simulated and file is not None and file.describes(f"{namespace}/koop_guard")
    if file is not None and not simulated and not guarded:
        file.refuse_nearly(f"{namespace}/koop_guard", EXECUTABLES)
        notes.append(
            f"{file.path}: has no section koop_guard: whatever fails, the rig keeps the last theta"
        )
    optional = {"vdp_plant": simulated, "recorder": recorded, "koop_guard": guarded}
    started = [name for name in EXECUTABLES if optional.get(name, True)]
    classes = {name: ALL_NODES[name] for name in started}
    values = {
        name: {
            key: value
            for key, value in (shared or {}).items()
            if key in names_of(classes_of) or key.startswith(parameter_file.ROS_OWN)
        }
        for name, classes_of in classes.items()
    }
    if file is not None:
        names_by_node = {name: names_of(classes_of) for name, classes_of in classes.items()}
        from_file = with_model_beside(file.path, file.values_of(names_by_node, namespace))
        values = {name: items | from_file[name] for name, items in values.items()}
        # a recorded run's own file names its recorder, which this launch may not start
        if any([items.pop("listeners", "next") != "next" for items in values.values()]):
            notes.append(f"{arguments['params']}: 'listeners' is not used: the launch sets it")
    for argument in ARGUMENTS:
        if argument.name in arguments and argument.node:
            if argument.node not in values:
                simulated_plant = "the simulated plant: plant:=true, or a section vdp_plant"
                need = simulated_plant if argument.node == "vdp_plant" else "record:=true"
                raise ConfigError(f"{argument.name}:={arguments[argument.name]}: needs {need}")
            values[argument.node] |= _values(argument, arguments[argument.name])
    if recorded and simulated:  # a rig's controller waits for no recorder, which could have failed
        for name in NODES:
            values[name]["listeners"] = "next recorder"
    if guarded:  # it alone commands the rig
        assert file is not None
        loop = file.path.with_name(file.path.name + namespace.replace("/", "-"))
        values["koop_guard"].setdefault("note", str(note_of(loop).resolve()))
        values["relay_esc"]["listeners"] = "koop_guard"
    configs = _check(values, classes)
    guard = configs["koop_guard"][GuardConfig] if guarded else None
    if guard is not None:
        split_command("on_alarm", guard.on_alarm)
    remaps = (f"relay_esc:{THETA}:={ASKED}",) if guard and guard.asked == ASKED else ()
    composed = _flag("composed", arguments, False)
    return Plan(values, namespace, not simulated, program, composed, remaps, tuple(notes))


def refuse_other_arguments(words: list[str]) -> None:
    """Raise ConfigError on a misspelt argument (``name:=value``), which launch would ignore.

    What is unlike any of ours is an argument of a file that includes this one.
    """
    defined = [argument.name for argument in ARGUMENTS]
    for name in (word.partition(":=")[0] for word in words):
        if difflib.get_close_matches(name, defined, cutoff=SIMILAR):
            refuse_unknown([name], defined, "argument")


def _program(file: ParameterFile | None, namespace: str) -> tuple[str, ...]:
    values = file.values(f"{namespace}/rig", names_of(RIG["rig"])) if file is not None else {}
    config = build({"rig": _node_values(values)}, RIG)["rig"][RigConfig]
    assert isinstance(config, RigConfig)
    return split_command("rig: command", config.command)


def _check(
    values: Mapping[str, Mapping[str, Any]], classes: Mapping[str, tuple[type, ...]]
) -> dict[str, dict[type, Any]]:
    configs = build({name: _node_values(items) for name, items in values.items()}, classes)
    steps = {
        name: config.dt
        for name, classes_of in configs.items()
        for config in classes_of.values()
        if hasattr(config, "dt")
    }
    if len(set(steps.values())) > 1:
        listed = ", ".join(f"{name} {dt:g}" for name, dt in steps.items())
        raise ConfigError(f"dt differs: {listed} s")
    if "koop_guard" in configs:
        esc, guard = configs["relay_esc"][EscConfig], configs["koop_guard"][GuardConfig]
        if esc.count != guard.count:
            raise ConfigError(
                f"knobs differ: the command of koop_guard {guard.count}, relay_esc {esc.count}: "
                "theta_initial and the like are lists with one number for each"
            )
        allowed = zip(guard.each("theta_min"), guard.each("theta_max"), strict=True)
        for i, (low, high) in enumerate(allowed):
            least, most = esc.knob(i).limits
            rounding = 1e-3 * (high - low)
            if least < low - rounding or high + rounding < most:
                raise ConfigError(
                    f"relay_esc seeks {guard.knob_names[i]} in [{least:g}, {most:g}], of which "
                    f"koop_guard allows [{low:g}, {high:g}]: narrow theta_min, theta_max and widest"
                )
    lifter = configs["koopman_lifter"]
    load_for(lifter[LifterConfig], lifter[ModelConfig])
    if "recorder" in configs:
        output = configs["recorder"][RecorderConfig].output
        if output and (Path(output).expanduser() / "bag").exists():
            raise ConfigError(f"{output} holds a recording already: choose another output")
    return configs


def return_time(values: Mapping[str, Mapping[str, Any]]) -> float:
    """Return how long the guard may take to return theta at its end [s]; 0 without one."""
    config = guard_config(values)
    return 0.0 if config is None else config.longest_return


def guard_config(values: Mapping[str, Mapping[str, Any]]) -> GuardConfig | None:
    """Return the configuration of the guard; None without one."""
    if "koop_guard" not in values:
        return None
    guard = {"koop_guard": _node_values(values["koop_guard"])}
    config = build(guard, GUARD)["koop_guard"][GuardConfig]
    assert isinstance(config, GuardConfig)
    return config


def _node_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out what every node has."""
    return {k: v for k, v in values.items() if not k.startswith(parameter_file.ROS_OWN)}


def _namespace(text: str) -> str:
    parts = text.strip("/").split("/") if text.strip("/") else []
    if not all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", part) for part in parts):
        raise ConfigError(f"namespace:={text}: is not a namespace of ROS 2")
    return "".join(f"/{part}" for part in parts)


def _flag(name: str, arguments: Mapping[str, str], default: bool) -> bool:
    if name not in arguments:
        return default
    if arguments[name] not in FLAGS:
        raise ConfigError(f"{name}:={arguments[name]}: must be true or false")
    return arguments[name].lower() == "true"


def _values(argument: Argument, text: str) -> dict[str, Any]:
    """Return the parameters that an argument sets."""
    if argument.name == "pace":
        return pace_values(text)
    try:
        return {argument.name: argument.kind(text)}
    except ValueError:
        kind = "whole number" if argument.kind is int else "number"
        raise ConfigError(f"{argument.name}:={text}: must be a {kind}") from None
