"""Several nodes in one process, on one executor: ``koop_node container``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from itertools import pairwise
from typing import Any

from rclpy.utilities import remove_ros_args

from koop_core.config.describe import ARGUMENTS
from koop_core.config.parameter import ConfigError
from koop_node.node.main import run_nodes
from koop_node.node.managed import ManagedNode

GROUP = "rclpy_components"
"""Entry points by which packages offer nodes; the names are ``package::Class``."""


def components() -> dict[str, EntryPoint]:
    """Return the nodes that installed packages offer, by name."""
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def load(name: str, namespace: str = "") -> ManagedNode[Any]:
    """Make a node.

    Parameters
    ----------
    name : str
        ``package::Class``.
    namespace : str
        Of the node; empty: that of the process.

    Raises
    ------
    ConfigError
        If no package offers it.
    """
    offered = components()
    if name not in offered:
        raise ConfigError(f"there is no component {name!r}; there are {', '.join(sorted(offered))}")
    options = {"namespace": namespace} if namespace else {}
    node: ManagedNode[Any] = offered[name].load()(**options)
    return node


def hint(words: Sequence[str], names: Sequence[str]) -> str:
    """Return what to do where a parameter of one node was given to all of several; else nothing."""
    pairs = pairwise(words)
    given = [item for flag, item in pairs if flag in ("-p", "--param")]
    if len(names) < 2 or not any(":" not in item.partition(":=")[0] for item in given):
        return ""
    return "; '-p NAME:=VALUE' is for all nodes of a container, '-p NODE:NAME:=VALUE' for one"


def refuse_equal_names(names: Sequence[str]) -> None:
    """Raise ConfigError if two nodes have one name: services and parameters would be of either."""
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(
                f"two nodes are named {name}: put one into a namespace, as in COMPONENT@/rig"
            )


def main() -> None:
    """Run the nodes until they are told to stop or the first one has ended."""
    parser = argparse.ArgumentParser(
        prog="ros2 run koop_node container",
        usage=f"%(prog)s [--keep-going] COMPONENT[@NAMESPACE]... {ARGUMENTS}",
        description="Runs several nodes in one process, on one executor: messages between them do "
        "not leave the process. Each keeps its name, lifecycle, parameters and diagnostics; "
        "parameters come from a file with a section a node.",
    )
    parser.add_argument(
        "components",
        nargs="+",
        metavar="COMPONENT",
        help=f"those who listen first; one of {', '.join(sorted(components()))}; "
        "@NAMESPACE: in that namespace, such as @/rig",
    )
    parser.add_argument(
        "--keep-going",
        action="store_true",
        help="when a node ends, the others go on until none is left (default: the end of one ends "
        "all, with its exit code; 1 if it is not the last one named)",
    )
    given = parser.parse_args(remove_ros_args()[1:])

    def make() -> list[ManagedNode[Any]]:
        nodes = []
        for word in given.components:
            name, _, namespace = word.partition("@")
            try:
                nodes.append(load(name, namespace))
            except ConfigError as error:
                raise ConfigError(f"{name}: {error}{hint(sys.argv, given.components)}") from None
        refuse_equal_names([node.get_fully_qualified_name() for node in nodes])
        return nodes

    sys.exit(run_nodes(make, keep_going=given.keep_going))
