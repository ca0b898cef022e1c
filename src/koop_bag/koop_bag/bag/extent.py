"""All fields of a topic down to single numbers and strings, however long its arrays are."""

import struct
from dataclasses import dataclass, field

import numpy as np

from koop_bag.bag.columns import STORED, Columns, definition_of, iter_decoded
from koop_bag.bag.reader import BagReader
from koop_bag.cdr.definition import Array, MessageType, Primitive, Struct, Text
from koop_bag.cdr.gather import Bytes, Offsets, decode
from koop_bag.cdr.layout import ENCAPSULATION, Layout, LayoutFinder
from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import MESSAGE_HEAD

LONGEST = 1000
"""Arrays of more numbers than this (images, point clouds) make no columns."""

_LENGTH = struct.Struct("<I")


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


class _Lengths(LayoutFinder):
    """Notes the length of every array of every layout that the messages of a topic have."""

    def __init__(self, root: Struct) -> None:
        super().__init__(root, ())
        self._kind = root
        self._found: dict[str, int] = {}

    def longest(self, path: str, kind: Array) -> int:
        """Largest length of an array."""
        return self._found.get(path, kind.count or 0)

    def decode(self, buffer: Bytes, starts: Offsets, sizes: Offsets) -> Columns:
        """Look at messages; messages of equal layout are looked at once."""
        fixed = MESSAGE_HEAD.size
        return decode(buffer, starts + fixed, sizes - fixed, self)

    def find(self, message: bytes) -> Layout:
        """Walk one message."""
        walk = _Walk(message)
        try:
            walk.visit(self._kind, "")
        except struct.error:
            raise BagError(f"a message is too short for a {self._kind.name}") from None
        for path, length in walk.lengths.items():
            self._found[path] = max(self._found.get(path, 0), length)
        return Layout(tuple(walk.guards), {})


class _Walk:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = ENCAPSULATION
        self.guards: list[tuple[int, int]] = []
        self.lengths: dict[str, int] = {}

    def visit(self, kind: MessageType, path: str) -> None:
        """Walk over one value."""
        if isinstance(kind, Primitive):
            self._skip(kind.dtype.itemsize, 1)
        elif isinstance(kind, Text):
            # DDS vendors differ in how wide characters are serialized
            if kind.wide:
                raise BagError("wide strings are not supported")
            length = self._length_word()
            self._at += length
        elif isinstance(kind, Array):
            count = self._length_word() if kind.count is None else kind.count
            self.lengths[path] = count
            if isinstance(kind.element, Primitive):
                self._skip(kind.element.dtype.itemsize, count)
            else:
                for index in range(count):
                    self.visit(kind.element, f"{path}[{index}]")
        else:
            for name, inner in kind.fields:
                self.visit(inner, f"{path}.{name}" if path else name)
        if self._at > len(self._data):
            raise struct.error("past the end")

    def _skip(self, size: int, count: int) -> None:
        if count:  # an empty sequence is not aligned
            self._at += -(self._at - ENCAPSULATION) % size + size * count

    def _length_word(self) -> int:
        self._at += -(self._at - ENCAPSULATION) % 4
        (length,) = _LENGTH.unpack_from(self._data, self._at)
        self.guards.append((self._at, length))
        self._at += 4
        return int(length)
