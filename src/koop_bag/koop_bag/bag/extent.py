"""All fields of a topic down to single numbers and strings, however long its arrays are."""

from dataclasses import dataclass, field

import numpy as np

from koop_bag.bag.columns import STORED, Columns, definition_of, iter_decoded
from koop_bag.bag.reader import BagReader
from koop_bag.cdr.gather import Bytes, Offsets, decode
from koop_bag.cdr.layout import Layout, walk
from koop_bag.mcap.file_reader import MESSAGE_HEAD
from koop_core.cdr import Array, MessageType, Primitive, Struct, Text

LONGEST = 1000
"""Arrays of more numbers than this (images, point clouds) make no columns."""


@dataclass
class Extent:
    """The scalar fields of one topic.

    Attributes
    ----------
    fields : dict of str to dtype
        By name (`step`, `header.stamp`, `x[0]`, `status[1].name`), in the order of the message. A
        stamp is int64 nanoseconds, a string has dtype object. An element that a message lacks,
        because its array is shorter there, reads as NaN.
    left_out : list of str
        Arrays that are too long, and wide strings.
    """

    fields: "dict[str, np.dtype[np.generic]]" = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)


def measure(bag: BagReader, topic: str) -> Extent:
    """Find the scalar fields of a topic; reads the topic through if it has arrays."""
    root = definition_of(bag, topic)
    lengths = _Lengths(root)
    for _ in iter_decoded(bag, {topic: lengths}) if _has_sequences(root) else ():
        pass
    extent = Extent()
    _list(root, "", lengths, extent)
    return extent


def _has_sequences(kind: MessageType) -> bool:
    if isinstance(kind, Array):
        return kind.count is None or _has_sequences(kind.element)
    return isinstance(kind, Struct) and any(_has_sequences(inner) for _, inner in kind.fields)


def _list(kind: MessageType, path: str, lengths: "_Lengths", extent: Extent) -> None:
    if isinstance(kind, Struct) and not (kind.is_stamp and path):
        for name, inner in kind.fields:
            _list(inner, f"{path}.{name}" if path else name, lengths, extent)
    elif isinstance(kind, Array):
        length = lengths.longest(path, kind)
        if length > LONGEST:
            extent.left_out.append(path)
            return
        for index in range(length):
            _list(kind.element, f"{path}[{index}]", lengths, extent)
    elif isinstance(kind, Text) and kind.wide:
        extent.left_out.append(path)
    else:
        dtype = np.dtype(np.int64) if isinstance(kind, Struct) else np.dtype(object)
        name = f".{path}" if path in STORED else path
        extent.fields[name] = kind.dtype if isinstance(kind, Primitive) else dtype


class _Lengths:
    """Lengths of all arrays in all layouts that the messages of a topic have."""

    def __init__(self, root: Struct) -> None:
        self._root = root
        self._longest: dict[str, int] = {}

    def longest(self, path: str, kind: Array) -> int:
        """Largest length of an array."""
        return self._longest.get(path, kind.count or 0)

    def decode(self, buffer: Bytes, starts: Offsets, sizes: Offsets) -> Columns:
        """Look at messages; messages of equal layout are looked at once."""
        fixed = MESSAGE_HEAD.size
        return decode(buffer, starts + fixed, sizes - fixed, self)

    def find(self, message: bytes) -> Layout:
        """Walk one message."""
        return Layout(walk(self._root, message, _Measured("", self._longest)), {})


@dataclass
class _Measured:
    """A value whose arrays are measured."""

    path: str
    longest: dict[str, int]

    def inner(self, key: str | int) -> "_Measured":
        """Return the measure of a field or element."""
        if isinstance(key, int):
            return _Measured(f"{self.path}[{key}]", self.longest)
        return _Measured(f"{self.path}.{key}" if self.path else key, self.longest)

    def take(self, kind: MessageType, start: int, count: int) -> bool:
        """Note the length of an array."""
        if isinstance(kind, Array):
            self.longest[self.path] = max(self.longest.get(self.path, 0), count)
        return False
