"""Finds out whether bytes can be a message, before they are handed to code that trusts them. Pure.

Who deserialises allocates as many elements as a length word says, before it looks how many bytes
there are.
"""

from __future__ import annotations

from koop_bag.cdr.definition import MessageType, Primitive, Struct, Text

HEAD = 4  # bytes of the encapsulation
_DEEP = 50


class CdrError(ValueError):
    """The bytes are no message of the type."""


def check(kind: Struct, data: bytes) -> None:
    """Raise CdrError unless bytes are one message of a type in plain little-endian CDR."""
    if data[:2] != b"\x00\x01" or len(data) < HEAD:
        raise CdrError("not in little-endian CDR")
    if _end(kind, data, HEAD, 0) > len(data):
        raise CdrError("cut short")


def _end(kind: MessageType, data: bytes, at: int, depth: int) -> int:
    """Return where what begins at a place ends."""
    if at > len(data) or depth > _DEEP:
        raise CdrError("cut short")
    if isinstance(kind, Primitive):
        size = kind.dtype.itemsize
        return at + -(at - HEAD) % size + size
    if isinstance(kind, Text):
        length, at = _length(data, at)
        return at + length * (4 if kind.wide else 1)
    if isinstance(kind, Struct):
        for _, inner in kind.fields:
            at = _end(inner, data, at, depth + 1)
        return at
    count = kind.count
    if count is None:
        count, at = _length(data, at)
    if isinstance(kind.element, Primitive):
        size = kind.element.dtype.itemsize
        return at + (-(at - HEAD) % size + count * size if count else 0)
    for _ in range(count):  # an element has a byte at least, so it ends with the data
        at = _end(kind.element, data, at, depth + 1)
    return at


def _length(data: bytes, at: int) -> tuple[int, int]:
    at += -(at - HEAD) % 4
    length = int.from_bytes(data[at : at + 4], "little")
    if at + 4 > len(data):
        raise CdrError("cut short")
    return length, at + 4
