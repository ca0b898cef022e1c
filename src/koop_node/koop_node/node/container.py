"""Several nodes in one process, on one executor: ``koop_node container``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from itertools import pairwise
from typing import Any

from rclpy.utilities import remove_ros_args

from koop_core.config.describe import ARGUMENTS
from koop_core.config.parameter import ConfigError
from koop_node.node.main import run_nodes
from koop_node.node.managed import ManagedNode
from koop_node.node.stages import Stages, stages_of_one


def components() -> dict[str, EntryPoint]:
    """Return the nodes that installed packages offer, by name: ``package::Class``."""
    return {entry.name: entry for entry in entry_points(group="rclpy_components")}


def make(words: Sequence[str]) -> list[ManagedNode[Any]]:
    """Make the nodes ``package::Class`` or ``package::Class@NAMESPACE``.

    Raises ConfigError if no package offers one, it refuses its parameters, or two have the same
    name: services and parameters would be of either.
    """
    offered, nodes = components(), {}
    for word in words:
        name, _, namespace = word.partition("@")
        if name not in offered:
            names = ", ".join(sorted(offered))
            raise ConfigError(f"there is no component {name!r}; there are {names}")
        try:
            node = offered[name].load()(**({"namespace": namespace} if namespace else {}))
        except ConfigError as error:
            raise ConfigError(f"{name}: {error}{hint(sys.argv, words)}") from None
        if (full_name := node.get_fully_qualified_name()) in nodes:
            raise ConfigError(
                f"two nodes are named {full_name}: put one into a namespace, as in COMPONENT@/rig"
            )
        nodes[full_name] = node
    return list(nodes.values())


def find_stages(nodes: list[ManagedNode[Any]]) -> list[Stages]:
    """Return the compiled stages that installed packages know of nodes that share a process."""
    if len(nodes) == 1:
        return stages_of_one(nodes)
    found = [entry.load()(nodes) for entry in entry_points(group="koop_stages")]
    return [stages for each in found for stages in each]


def hint(arguments: Sequence[str], nodes: Sequence[str]) -> str:
    """Return what to do where a parameter of one node was given to all of several; else nothing."""
    values = [item for flag, item in pairwise(arguments) if flag in ("-p", "--param")]
    if len(nodes) < 2 or all(":" in item.partition(":=")[0] for item in values):
        return ""
    return "; '-p NAME:=VALUE' is for all nodes of a container, '-p NODE:NAME:=VALUE' for one"


def main() -> int:
    """Run the nodes until they are told to stop or the first has ended; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="ros2 run koop_node container",
        usage=f"%(prog)s COMPONENT[@NAMESPACE]... {ARGUMENTS}",
        description="Runs several nodes in one process, on one executor: messages between them do "
        "not leave the process. Each keeps its name, lifecycle, parameters and diagnostics; "
        "parameters come from a file with a section a node. The end of one ends all, with its exit "
        "code; 1 if it is not the last one named.",
    )
    parser.add_argument(
        "components",
        nargs="+",
        metavar="COMPONENT",
        help=f"listeners first; one of {', '.join(sorted(components()))}; "
        "@NAMESPACE: in that namespace, such as @/rig",
    )
    options = parser.parse_args(remove_ros_args()[1:])
    return run_nodes(partial(make, options.components), find_stages=find_stages)
