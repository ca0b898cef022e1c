"""Reads the step index of serialized messages without decoding them."""

from __future__ import annotations

import struct

from koop_bag.cdr.definition import parse_definition
from koop_core.cdr import Primitive, Struct

_LENGTH = struct.Struct("<I")
_STEP = struct.Struct("<Q")
_HEADER = "std_msgs/Header"
# Encapsulation, sec, nanosec; the length of frame_id follows, then its characters, then the step.
_FRAME_ID = 12


def step_of(message: bytes) -> int:
    """Return the step of a serialized message for whose type :func:`has_step` holds."""
    (length,) = _LENGTH.unpack_from(message, _FRAME_ID)
    # The step lies at the next multiple of 8, counted from the end of the encapsulation.
    (step,) = _STEP.unpack_from(message, 4 + (_FRAME_ID + length + 7 & ~7))
    return int(step)


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
