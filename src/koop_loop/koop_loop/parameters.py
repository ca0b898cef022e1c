"""The parameters of the whole loop, read from the ROS 2 parameter files that the nodes read.

One YAML file serves ``ros2 run --ros-args --params-file``, the launch file and the offline
commands; so does the ``parameters.yaml`` in the folder of a recorded run.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from koop_node.config import ConfigError, NodeConfig
from koopman_lifter.config import LifterConfig, ModelConfig
from koopman_lifter.model import KoopmanModel, load
from relay_esc.config import EscConfig
from vdp_plant.config import PaceConfig, PlantConfig

NODES: dict[str, tuple[type, ...]] = {
    "vdp_plant": (PlantConfig, PaceConfig, NodeConfig),
    "koopman_lifter": (LifterConfig, ModelConfig, NodeConfig),
    "relay_esc": (EscConfig, NodeConfig),
}
ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides")


@dataclass(frozen=True)
class LoopParameters:
    """Configurations of the three nodes, without ROS."""

    plant: PlantConfig
    pace: PaceConfig
    lifter: LifterConfig
    model: ModelConfig
    esc: EscConfig

    def load_model(self) -> KoopmanModel:
        """Read the model file.

        Raises
        ------
        koopman_lifter.model.ModelError
            If it cannot be used.
        """
        return load(self.model.path)

    def as_ros(self) -> dict[str, dict[str, Any]]:
        """Return the parameters by node name, in the terms of a ROS 2 parameter file."""
        values = {
            "vdp_plant": asdict(self.plant) | asdict(self.pace),
            "koopman_lifter": asdict(self.lifter) | asdict(self.model),
            "relay_esc": asdict(self.esc),
        }
        return {
            # ROS cannot tell the type of an empty list, and it is the default where it occurs
            node: {k: list(v) if isinstance(v, tuple) else v for k, v in given.items() if v != ()}
            for node, given in values.items()
        }


def make(values: dict[str, dict[str, Any]]) -> LoopParameters:
    """Build the configurations from values by node; what is not given is the default.

    Raises
    ------
    ConfigError
        On an unknown node or parameter or a value that cannot be used; names the node.
    """
    built: dict[type, Any] = {}
    for node in values:
        if node not in NODES:
            raise ConfigError(f"unknown node {node}; the loop has {', '.join(NODES)}")
    for node, classes in NODES.items():
        given = values.get(node, {})
        known = {item.name for cls in classes for item in fields(cls)}
        unknown = sorted(name for name in given if name not in known)
        if unknown:
            raise ConfigError(
                f"{node}: unknown parameter {', '.join(unknown)}; known: {', '.join(sorted(known))}"
            )
        for cls in classes:
            names = {item.name for item in fields(cls)}
            try:
                built[cls] = cls(**{k: v for k, v in given.items() if k in names})
            except ConfigError as error:
                raise ConfigError(f"{node}: {error}") from None
    return LoopParameters(
        built[PlantConfig],
        built[PaceConfig],
        built[LifterConfig],
        built[ModelConfig],
        built[EscConfig],
    )


def read(path: str | Path) -> dict[str, dict[str, Any]]:
    """Read the values of the loop's nodes from a ROS 2 parameter file.

    ``/**`` applies to every node that has the parameter; namespaces and other nodes are ignored.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no parameter file.
    """
    try:
        content = yaml.safe_load(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: is no ROS 2 parameter file")
    values: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    for key, section in content.items():
        given = section.get("ros__parameters") if isinstance(section, dict) else None
        if not isinstance(given, dict):
            raise ConfigError(f"{path}: '{key}' has no ros__parameters")
        given = {k: v for k, v in given.items() if k not in ROS_OWN}
        if key in ("/**", "**"):
            for node, classes in NODES.items():
                known = {item.name for cls in classes for item in fields(cls)}
                values[node].update({k: v for k, v in given.items() if k in known})
        elif (node := str(key).rsplit("/", 1)[-1]) in values:
            values[node].update(given)
    return values


def write(values: dict[str, dict[str, Any]], path: str | Path) -> None:
    """Write values by node as a ROS 2 parameter file."""
    content = {f"/**/{node}": {"ros__parameters": given} for node, given in values.items()}
    Path(path).write_text(yaml.safe_dump(content, sort_keys=False))


def changed(
    values: dict[str, dict[str, Any]], *overrides: tuple[str, str, Any]
) -> dict[str, dict[str, Any]]:
    """Return ``values`` with (node, parameter, value) overrides; None changes nothing."""
    result = {node: dict(given) for node, given in values.items()}
    for node, name, value in overrides:
        if value is not None:
            result.setdefault(node, {})[name] = value
    return result
