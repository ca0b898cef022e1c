"""Whether messages of a type begin as those of the loop do."""

from __future__ import annotations

from koop_bag.cdr.definition import parse_definition
from koop_core.cdr import Primitive, Struct

_HEADER = "std_msgs/Header"


def has_step(type_name: str, definition: str) -> bool:
    """Return whether messages of a type begin with `std_msgs/Header` and `uint64 step`."""
    fields = parse_definition(type_name, definition).fields
    if len(fields) < 2:
        return False
    (_, header), (name, step) = fields[:2]
    return (
        isinstance(header, Struct)
        and header.name == _HEADER
        and name == "step"
        and isinstance(step, Primitive)
        and step.dtype == "<u8"
    )
