"""Messages and parameters of other programs: on damaged ones rclpy raises, and a node would end."""

from __future__ import annotations

from array import array
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message


def read_message(data: bytes, kind: Any) -> Any:
    """Return the message of a type that bytes hold; None if they hold none."""
    try:
        return deserialize_message(data, kind)
    except rclpy_implementation.RMWError:
        return None


def read_value(value: Any) -> Any:
    """Return a ParameterValue as Python's, an array as a list; None if its type is unknown."""
    try:
        plain = parameter_value_to_python(value)
    except RuntimeError:
        return None
    return list(plain) if isinstance(plain, array | tuple) else plain
