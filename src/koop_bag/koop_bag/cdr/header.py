"""Reads step index and stamp out of serialized messages without decoding them."""

from __future__ import annotations

import struct

from koop_bag.cdr.definition import parse_definition
from koop_bag.cdr.schema import MessageSchema
from koop_core.cdr import Primitive, Struct

_LENGTH = struct.Struct("<I")
_STEP = struct.Struct("<Q")
_STAMP = struct.Struct("<iI")
_HEADER = "std_msgs/Header"
# Encapsulation, sec, nanosec; the length of frame_id follows, then its characters, then the step.
_FRAME_ID = 12


def step_of(message: bytes) -> int:
    """The step of a serialized message for whose type :func:`has_step` holds."""
    (length,) = _LENGTH.unpack_from(message, _FRAME_ID)
    # The step lies at the next multiple of 8, counted from the end of the encapsulation.
    (step,) = _STEP.unpack_from(message, 4 + (_FRAME_ID + length + 7 & ~7))
    return int(step)


def stamp_of(message: bytes) -> int:
    """The header stamp [ns] of a serialized message for whose type :func:`has_header` holds."""
    seconds, nanoseconds = _STAMP.unpack_from(message, 4)
    return int(seconds * 1_000_000_000 + nanoseconds)


def has_header(schema: MessageSchema) -> bool:
    """Whether messages of this type begin with `std_msgs/Header`."""
    fields = parse_definition(schema.name, schema.text).fields
    return bool(fields) and isinstance(fields[0][1], Struct) and fields[0][1].name == _HEADER


def has_step(schema: MessageSchema) -> bool:
    """Whether messages of this type begin with `std_msgs/Header` and `uint64 step`."""
    fields = parse_definition(schema.name, schema.text).fields
    if len(fields) < 2:
        return False
    name, step = fields[1]
    return (
        has_header(schema)
        and name == "step"
        and isinstance(step, Primitive)
        and step.dtype == "<u8"
    )
