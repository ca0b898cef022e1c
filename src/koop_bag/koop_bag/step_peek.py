"""Reads the step index out of serialized messages without decoding them."""

from __future__ import annotations

import struct

from koop_bag.losses import StepCounter
from koop_bag.msgdef import Primitive, Struct, parse_definition
from koop_bag.schema import MessageSchema

_LENGTH = struct.Struct("<I")
_STEP = struct.Struct("<Q")
# Encapsulation, sec, nanosec; the length of frame_id follows, then its characters, then the step.
_FRAME_ID = 12


class StepPeek:
    """Counts losses on one topic whose messages begin with a Header and `uint64 step`."""

    __slots__ = ("counter",)

    def __init__(self) -> None:
        self.counter = StepCounter()

    def see(self, message: bytes) -> None:
        """Count one serialized message."""
        (length,) = _LENGTH.unpack_from(message, _FRAME_ID)
        # The step lies at the next multiple of 8, counted from the end of the encapsulation.
        (step,) = _STEP.unpack_from(message, 4 + (_FRAME_ID + length + 7 & ~7))
        self.counter.add(step)


def has_step(schema: MessageSchema) -> bool:
    """Whether messages of this type begin with `std_msgs/Header` and `uint64 step`."""
    fields = parse_definition(schema.name, schema.text).fields
    if len(fields) < 2:
        return False
    (_, header), (name, step) = fields[:2]
    is_header = isinstance(header, Struct) and header.name == "std_msgs/Header"
    return is_header and name == "step" and isinstance(step, Primitive) and step.dtype == "<u8"
