"""Where the wanted fields of a serialized message lie.

In CDR the place of a field depends on nothing but the length words (of strings and sequences)
before it. So one message is walked; every other message with the same length words at the same
places has the same layout, and its fields can be taken out without a walk.
"""

import struct
from dataclasses import dataclass, field

import numpy as np

from koop_bag.cdr.definition import Array, MessageType, Primitive, Struct, Text, leaf_fields
from koop_bag.errors import BagError
from koop_core.config.fields import parse_field
from koop_core.config.parameter import ConfigError

ENCAPSULATION = 4
"""Bytes before the serialized data; alignment counts from their end."""

_LENGTH = struct.Struct("<I")
_Key = str | int


@dataclass(frozen=True)
class Span:
    """Where a field lies: `offset` from the message's first byte, `count` elements of `dtype`.

    `count` is None for a single number; for a string (dtype `S`) it is the number of bytes; a stamp
    has dtype `V8`.
    """

    offset: int
    dtype: "np.dtype[np.generic]"
    count: int | None = None


@dataclass(frozen=True)
class Layout:
    """Layout shared by all messages whose length words are `guards` (offset, value)."""

    guards: tuple[tuple[int, int], ...]
    spans: dict[str, Span | None]
    """By field; None where the message has no such element."""


@dataclass
class _Wanted:
    names: list[str] = field(default_factory=list)
    inner: "dict[_Key, _Wanted]" = field(default_factory=dict)


class LayoutFinder:
    """Finds layouts for one message type and a choice of fields.

    Parameters
    ----------
    root : Struct
        Message type.
    fields : sequence of str
        `step`, `header.stamp`, `x`, `position[0]`, `status[0].name`, ...
    """

    def __init__(self, root: Struct, fields: tuple[str, ...]) -> None:
        self._root = root
        self._wanted = _Wanted()
        self._count = len(set(fields))
        for name in fields:
            _check(root, name, name)
            node = self._wanted
            for key in _keys(name):
                node = node.inner.setdefault(key, _Wanted())
            if name not in node.names:
                node.names.append(name)

    def find(self, message: bytes) -> Layout:
        """Walk one message. Raises BagError if it is shorter than its type says."""
        walk = _Walk(message)
        try:
            if self._count:
                walk.visit(self._root, self._wanted, self._count)
        except struct.error:
            raise BagError(
                f"a message is cut short: {len(message)} bytes are too few for a {self._root.name}"
            ) from None
        return Layout(tuple(walk.guards), walk.spans)


class _Walk:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = ENCAPSULATION
        self.guards: list[tuple[int, int]] = []
        self.spans: dict[str, Span | None] = {}

    def visit(self, kind: MessageType, wanted: _Wanted | None, missing: int) -> None:
        """Walk over one value, or until nothing is missing any more: then the position is wrong."""
        if isinstance(kind, Primitive):
            self._align(kind.dtype.itemsize)
            self._found(wanted, Span(self._at, kind.dtype))
            self._skip(kind.dtype.itemsize)
        elif isinstance(kind, Text):
            length = self._length_word()
            if kind.wide:
                raise BagError(
                    "wide strings are not supported: choose fields that come before them"
                )
            without_zero = max(0, length - 1)
            self._found(wanted, Span(self._at, np.dtype("S"), without_zero))
            self._skip(length)
        elif isinstance(kind, Array):
            self._visit_array(kind, wanted, missing)
        else:
            if kind.is_stamp and wanted is not None:
                self._align(4)
                self._found(wanted, Span(self._at, np.dtype("V8")))
            for name, inner in kind.fields:
                if len(self.spans) >= missing:
                    return
                self.visit(inner, wanted.inner.get(name) if wanted else None, missing)

    def _visit_array(self, kind: Array, wanted: _Wanted | None, missing: int) -> None:
        count = self._length_word() if kind.count is None else kind.count
        if isinstance(kind.element, Primitive):
            dtype = kind.element.dtype
            if count:  # an empty sequence is not aligned
                self._align(dtype.itemsize)
            start = self._at
            self._skip(count * dtype.itemsize)
            self._found(wanted, Span(start, dtype, count))
            for index, inner in (wanted.inner if wanted else {}).items():
                if isinstance(index, int) and index < count:
                    self._found(inner, Span(start + index * dtype.itemsize, dtype))
        else:
            for index in range(count):
                if len(self.spans) >= missing:
                    return
                self.visit(kind.element, wanted.inner.get(index) if wanted else None, missing)
        for index, inner in (wanted.inner if wanted else {}).items():
            if isinstance(index, int) and index >= count:
                self._absent(inner)

    def _absent(self, wanted: _Wanted) -> None:
        self._found(wanted, None)
        for inner in wanted.inner.values():
            self._absent(inner)

    def _found(self, wanted: _Wanted | None, span: Span | None) -> None:
        for name in wanted.names if wanted else ():
            self.spans[name] = span

    def _align(self, size: int) -> None:
        self._at += -(self._at - ENCAPSULATION) % size

    def _length_word(self) -> int:
        self._align(4)
        (length,) = _LENGTH.unpack_from(self._data, self._at)
        self.guards.append((self._at, length))
        self._at += 4
        return int(length)

    def _skip(self, size: int) -> None:
        self._at += size
        if self._at > len(self._data):
            raise struct.error("past the end")


def _keys(name: str) -> list[_Key]:
    try:
        path = parse_field(name.removeprefix("."))  # a dot tells it from a stored column
    except ConfigError as error:
        raise BagError(str(error)) from None
    return [key for pair in path for key in pair if key is not None]


def _check(root: Struct, name: str, shown: str) -> None:
    kind: MessageType = root
    for key in _keys(name):
        if isinstance(key, int) and isinstance(kind, Array):
            kind = kind.element
        elif isinstance(key, str) and isinstance(kind, Struct) and key in dict(kind.fields):
            kind = dict(kind.fields)[key]
        else:
            known = ", ".join(leaf_fields(root)) or "no column"
            raise BagError(f"{root.name} has no field '{shown}'; it has {known}")
    if isinstance(kind, Struct) and not kind.is_stamp:
        inner = ", ".join(f"{shown}.{item}" for item in leaf_fields(kind))
        raise BagError(f"'{shown}' is a message of its own; choose one of its fields: {inner}")
    if isinstance(kind, Array) and not isinstance(kind.element, Primitive):
        raise BagError(
            f"'{shown}' is an array of messages or strings; choose an element, such as '{shown}[0]'"
        )
