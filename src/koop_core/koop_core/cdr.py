"""Serialized messages (plain CDR): their types, and where each value of a message lies. Pure.

The place of a value depends on nothing but the length words (of strings and sequences) before it.
So all messages with the same length words at the same places have the same layout.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

ENCAPSULATION = 4
"""Bytes before the serialized data; alignment counts from their end."""

STAMPS = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
_LENGTH_WORDS = {b"\0\0": struct.Struct(">I"), b"\0\1": struct.Struct("<I")}


class CdrError(ValueError):
    """Bytes that are not a message of the type; the text continues 'a message is'."""


@dataclass(frozen=True)
class Primitive:
    """A number or bool of fixed size."""

    dtype: np.dtype[np.generic]


@dataclass(frozen=True)
class Text:
    """A string."""

    wide: bool = False


@dataclass(frozen=True)
class Array:
    """Elements in a row: `count` of them, or as many as a length word says (None)."""

    element: MessageType
    count: int | None


@dataclass(frozen=True)
class Struct:
    """A message. `fields` in the order in which they are serialized."""

    name: str
    fields: tuple[tuple[str, MessageType], ...]

    @property
    def is_stamp(self) -> bool:
        """Whether it is a time or duration, which reads as one number of nanoseconds."""
        return self.name in STAMPS


MessageType = Primitive | Text | Array | Struct


class Visitor(Protocol):
    """Takes values of one field, or of one element."""

    def take(self, kind: MessageType, start: int, count: int) -> bool:
        """Take a value of `count` bytes or elements; return whether the walk may end."""

    def inner(self, key: str | int) -> Any:
        """Return the visitor of a field or element, None to pass over it."""


class Walk:
    """One pass over a serialized message, encapsulation included, checked against its length.

    With ``wide``, wide strings are passed over, at four bytes a character; DDS vendors differ in
    it. CdrError is raised if the message is not in plain CDR or, from :meth:`visit`, too short.
    """

    def __init__(self, data: bytes, wide: bool = False) -> None:
        word = _LENGTH_WORDS.get(bytes(data[:2]))
        if word is None or len(data) < ENCAPSULATION:
            raise CdrError(f"not in plain CDR: it begins with {bytes(data[:4]).hex()}")
        self._data, self._word, self._wide = data, word, wide
        self._at = ENCAPSULATION
        self._done = False
        self.guards: list[tuple[int, int]] = []
        """Place and value of each length word."""

    def visit(self, kind: MessageType, visitor: Visitor | None = None) -> None:
        """Walk over one value, or until a visitor has all that it wants."""
        if isinstance(kind, Primitive):
            start = self._skip(kind.dtype.itemsize, 1)
            self._give(visitor, kind, start, 1)
        elif isinstance(kind, Text):
            if kind.wide and not self._wide:
                raise CdrError("not readable here: choose fields before its wide strings")
            length = self._length_word()
            start = self._skip(1, length * (4 if kind.wide else 1))
            self._give(visitor, kind, start, length)
        elif isinstance(kind, Array):
            self._visit_array(kind, visitor)
        else:
            if kind.is_stamp:
                self._give(visitor, kind, self._align(4), 1)
            for name, inner in kind.fields:
                if self._done:
                    return
                self.visit(inner, visitor.inner(name) if visitor else None)

    def _visit_array(self, kind: Array, visitor: Visitor | None) -> None:
        count = self._length_word() if kind.count is None else kind.count
        if isinstance(kind.element, Primitive):
            start = self._skip(kind.element.dtype.itemsize, count)
            self._give(visitor, kind, start, count)
            return
        self._give(visitor, kind, self._at, count)
        for index in range(count):  # an element has a byte at least, so this ends with the data
            if self._done:
                return
            self.visit(kind.element, visitor.inner(index) if visitor else None)

    def _give(self, visitor: Visitor | None, kind: MessageType, start: int, count: int) -> None:
        if visitor is not None:
            self._done = visitor.take(kind, start, count) or self._done

    def _align(self, size: int) -> int:
        self._at += -(self._at - ENCAPSULATION) % size
        return self._at

    def _length_word(self) -> int:
        start = self._skip(4, 1)
        (length,) = self._word.unpack_from(self._data, start)
        self.guards.append((start, length))
        return int(length)

    def _skip(self, size: int, count: int) -> int:
        """Pass over aligned items; return where they begin. An empty sequence is not aligned."""
        start = self._align(size) if count else self._at
        self._at = start + size * count
        if self._at > len(self._data):
            raise CdrError(f"cut short: it has {len(self._data)} bytes")
        return start


def check_message(kind: Struct, data: bytes) -> None:
    """Raise CdrError unless bytes are a message of a type in little-endian CDR.

    Deserializers allocate as many elements as a length word says before they look at the number of
    bytes.
    """
    if data[:2] != b"\0\1":
        raise CdrError("not in little-endian CDR")
    Walk(data, wide=True).visit(kind)
