"""Where the wanted fields of a serialized message lie.

One message is walked; every other message with the same length words at the same places has the
same layout, and its fields are taken without a walk.
"""

from dataclasses import dataclass

import numpy as np

from koop_bag.cdr.definition import leaf_fields
from koop_bag.errors import BagError
from koop_core.cdr import Array, CdrError, MessageType, Primitive, Struct, Text, Walk
from koop_core.config.fields import parse_field
from koop_core.config.parameter import ConfigError

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


class _Wanted:
    """A field or element, or what holds one."""

    def __init__(self, finder: "LayoutFinder") -> None:
        self._finder = finder
        self.names: list[str] = []
        self.fields: dict[_Key, _Wanted] = {}

    def inner(self, key: _Key) -> "_Wanted | None":
        """Return the node of a field or element, None if it is not wanted."""
        return self.fields.get(key)

    def take(self, kind: MessageType, start: int, count: int) -> bool:
        """Note where a value lies."""
        if isinstance(kind, Primitive):
            return self._note(Span(start, kind.dtype))
        if isinstance(kind, Text):
            return self._note(Span(start, np.dtype("S"), max(0, count - 1)))
        if isinstance(kind, Struct):
            return self._note(Span(start, np.dtype("V8")))
        element = kind.element.dtype if isinstance(kind.element, Primitive) else None
        done = self._note(Span(start, element, count) if element else None)
        for index, inner in self.fields.items():
            if isinstance(index, int) and index >= count:
                done = inner._absent()
            elif isinstance(index, int) and element:
                done = inner._note(Span(start + index * element.itemsize, element))
        return done

    def _absent(self) -> bool:
        for inner in self.fields.values():
            inner._absent()
        return self._note(None)

    def _note(self, span: Span | None) -> bool:
        return self._finder.note(self.names, span)


class LayoutFinder:
    """Finds layouts for one message type and a choice of fields.

    They are such as `step`, `header.stamp`, `x`, `position[0]`, `status[0].name`.
    """

    def __init__(self, root: Struct, fields: tuple[str, ...]) -> None:
        self._root = root
        self._wanted = _Wanted(self)
        self._count = len(set(fields))
        self._spans: dict[str, Span | None] = {}
        for name in fields:
            _check(root, name)
            node = self._wanted
            for key in _keys(name):
                node = node.fields.setdefault(key, _Wanted(self))
            if name not in node.names:
                node.names.append(name)

    def find(self, message: bytes) -> Layout:
        """Walk one message. Raises BagError if it is shorter than its type says."""
        self._spans = {}
        try:
            walk = Walk(message)
            walk.visit(self._root, self._wanted)
        except CdrError as error:
            raise BagError(f"a {self._root.name} is {error}") from None
        return Layout(tuple(walk.guards), self._spans)

    def note(self, names: list[str], span: Span | None) -> bool:
        """Note where fields lie; return whether no other one is wanted."""
        for name in names:
            self._spans[name] = span
        return len(self._spans) >= self._count


def _keys(name: str) -> list[_Key]:
    try:
        path = parse_field(name.removeprefix("."))  # the dot distinguishes it from a stored column
    except ConfigError as error:
        raise BagError(str(error)) from None
    return [key for pair in path for key in pair if key is not None]


def _check(root: Struct, name: str) -> None:
    kind: MessageType = root
    for key in _keys(name):
        if isinstance(key, int) and isinstance(kind, Array):
            kind = kind.element
        elif isinstance(key, str) and isinstance(kind, Struct) and key in dict(kind.fields):
            kind = dict(kind.fields)[key]
        else:
            columns = ", ".join(leaf_fields(root)) or "no column"
            raise BagError(f"{root.name} has no field '{name}'; it has {columns}")
    if isinstance(kind, Struct) and not kind.is_stamp:
        inner = ", ".join(f"{name}.{item}" for item in leaf_fields(kind))
        raise BagError(f"'{name}' is a message of its own; choose one of its fields: {inner}")
    if isinstance(kind, Array) and not isinstance(kind.element, Primitive):
        raise BagError(
            f"'{name}' is an array of messages or strings; choose an element, such as '{name}[0]'"
        )
