"""The parameters of the whole loop, read from the ROS 2 parameter files that the nodes read.

One YAML file serves ``ros2 run --ros-args --params-file``, the launch file and the offline
commands; so does the ``parameters.yaml`` in the folder of a recorded run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from koop_core.config import parameter_file
from koop_core.config.parameter import (
    ConfigError,
    ListenersConfig,
    NodeConfig,
    Settings,
    parameter,
    refuse_unknown,
)
from koop_core.config.parameter_file import ROS_OWN
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.model import KoopmanModel, load_for
from relay_esc.config import EscConfig
from vdp_plant.config import PaceConfig, PlantConfig

NODES: dict[str, tuple[type, ...]] = {
    "vdp_plant": (PlantConfig, PaceConfig, ListenersConfig, NodeConfig),
    "koopman_lifter": (LifterConfig, ModelConfig, ListenersConfig, NodeConfig),
    "relay_esc": (EscConfig, ListenersConfig, NodeConfig),
}


@dataclass(frozen=True)
class RigConfig(Settings):
    """The rig itself, as far as it is a program of this machine; no node reads it."""

    command: str = parameter(
        "",
        "program, with its arguments, that is the rig or its driver: started with the loop, ended "
        "with it, and its end ends the loop; empty: you start it yourself",
    )


RIG: dict[str, tuple[type, ...]] = {"rig": (RigConfig,)}
EXECUTABLES = {  # package and name, in the order of starting: listeners come before speakers
    "recorder": ("koop_bag", "recorder"),
    "koop_guard": ("koop_guard", "guard"),
    "relay_esc": ("relay_esc", "esc"),
    "koopman_lifter": ("koopman_lifter", "lifter"),
    "vdp_plant": ("vdp_plant", "plant"),
}
CONTAINER = ("koop_node", "container")
COMPONENTS = {  # of the nodes that a container may run, in the order of starting
    "relay_esc": "relay_esc::EscNode",
    "koopman_lifter": "koopman_lifter::LifterNode",
    "vdp_plant": "vdp_plant::PlantNode",
}


@dataclass(frozen=True)
class LoopParameters:
    """Configurations of the three nodes, without ROS."""

    plant: PlantConfig
    pace: PaceConfig
    lifter: LifterConfig
    model: ModelConfig
    esc: EscConfig

    def load_model(self) -> KoopmanModel | None:
        """Read the model file; None if the cost is raw and the file cannot be used.

        Raises
        ------
        koopman_lifter.model.ModelError
            If the lifted cost cannot have it.
        """
        return load_for(self.lifter, self.model)

    def as_ros(self) -> dict[str, dict[str, Any]]:
        """Return the parameters by node name, in the terms of a ROS 2 parameter file."""
        values = {
            "vdp_plant": asdict(self.plant) | asdict(self.pace),
            "koopman_lifter": asdict(self.lifter) | asdict(self.model),
            "relay_esc": asdict(self.esc),
        }
        return {
            # ROS cannot tell the type of an empty list, and it is the default where it occurs
            node: {k: list(v) if isinstance(v, tuple) else v for k, v in section.items() if v != ()}
            for node, section in values.items()
        }


def names_of(classes: Iterable[type]) -> set[str]:
    """Return the names of the parameters of a node with these configuration classes."""
    return {item.name for cls in classes for item in fields(cls)}


def build(
    values: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, tuple[type, ...]] = NODES
) -> dict[str, dict[type, Any]]:
    """Build configurations, by node and class, from values by node; the rest has its defaults.

    Raises
    ------
    ConfigError
        On an unknown node or parameter or a value that cannot be used; names the node.
    """
    refuse_unknown(values, nodes, "node")
    return {node: _build(node, values.get(node, {}), nodes) for node in nodes}


def _build(
    node: str, section: Mapping[str, Any], nodes: Mapping[str, tuple[type, ...]]
) -> dict[type, Any]:
    known = names_of(nodes[node])
    unknown = [name for name in section if name not in known]
    try:
        for name in unknown:
            if owners := [other for other in nodes if name in names_of(nodes[other])]:
                raise ConfigError(f"unknown parameter '{name}': a parameter of {', '.join(owners)}")
        refuse_unknown(unknown, sorted(known))
        return {
            cls: cls(**{name: section[name] for name in names_of([cls]) if name in section})
            for cls in nodes[node]
        }
    except ConfigError as error:
        raise ConfigError(f"{node}: {error}") from None


def make(values: Mapping[str, Mapping[str, Any]]) -> LoopParameters:
    """Build the configurations from values by node; other parameters have their defaults.

    Raises
    ------
    ConfigError
        On an unknown node or parameter or a value that cannot be used; names the node.
    """
    built = build(values)
    plant, lifter = built["vdp_plant"], built["koopman_lifter"]
    return LoopParameters(
        plant[PlantConfig],
        plant[PaceConfig],
        lifter[LifterConfig],
        lifter[ModelConfig],
        built["relay_esc"][EscConfig],
    )


def read(
    path: str | Path,
    nodes: Mapping[str, tuple[type, ...]] = NODES,
    namespace: str | None = None,
) -> dict[str, dict[str, Any]]:
    """Read the values of some nodes from a ROS 2 parameter file; other nodes are ignored.

    The namespace is by default the one that the file describes.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not a parameter file or has no parameters for any node.
    """
    names = {node: names_of(classes) for node, classes in nodes.items()}
    values = with_model_beside(path, parameter_file.read(path).values_of(names, namespace))
    return {
        node: {name: value for name, value in section.items() if not name.startswith(ROS_OWN)}
        for node, section in values.items()
    }


def with_model_beside(
    path: str | Path, values: dict[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return the values of a file; a relative path of its model is resolved beside the file.

    So a folder that holds both can be moved. Where an absolute path leads nowhere, the model is the
    one that the recorder has kept of that name. Where none is beside it, the path is left as it is.
    """
    section = values.get("koopman_lifter", {}).get("model")
    if not isinstance(section, str) or not section:
        return values
    named, folder = Path(section), Path(path).parent
    beside = folder / "model" / named.name if named.is_absolute() else folder / section
    if (named.is_absolute() and named.exists()) or not beside.is_file():
        return values
    return changed(values, ("koopman_lifter", "model", str(beside.resolve())))


def changed(
    values: dict[str, dict[str, Any]], *overrides: tuple[str, str, Any]
) -> dict[str, dict[str, Any]]:
    """Return ``values`` with (node, parameter, value) overrides; None changes nothing."""
    result = {node: dict(section) for node, section in values.items()}
    for node, name, value in overrides:
        if value is not None:
            result.setdefault(node, {})[name] = value
    return result
