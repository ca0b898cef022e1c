"""The private parts of rclpy that the nodes need, each with the reason."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node


def parameter_overrides(node: Node) -> dict[str, Any]:
    """Return all parameter values given at the start, also those that nobody declared.

    rclpy only offers to declare them all, with types guessed from the values and an event for each.
    """
    return {name: item.value for name, item in node._parameter_overrides.items()}
