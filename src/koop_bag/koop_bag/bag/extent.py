"""All fields of a topic down to single numbers and strings, however long its arrays are."""

from dataclasses import dataclass, field

import numpy as np

from koop_bag.bag.columns import STORED, TopicDecoder, definition_of, iter_decoded
from koop_bag.bag.reader import BagReader
from koop_bag.cdr.layout import Layout, walk
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
    """Find the scalar fields of a topic; reads it through, for the lengths of its arrays."""
    root = definition_of(bag, topic)
    longest: dict[str, int] = {}

    def find(message: bytes) -> Layout:
        return Layout(walk(root, message, _Measured("", longest)), {})

    for _ in iter_decoded(bag, {topic: TopicDecoder(topic, (), find)}):
        pass
    extent = Extent()
    _list(root, "", longest, extent)
    return extent


def _list(kind: MessageType, path: str, longest: dict[str, int], extent: Extent) -> None:
    if isinstance(kind, Struct) and not (kind.is_stamp and path):
        for name, inner in kind.fields:
            _list(inner, f"{path}.{name}" if path else name, longest, extent)
    elif isinstance(kind, Array):
        length = longest.get(path, kind.count or 0)
        if length > LONGEST:
            extent.left_out.append(path)
            return
        for index in range(length):
            _list(kind.element, f"{path}[{index}]", longest, extent)
    elif isinstance(kind, Text) and kind.wide:
        extent.left_out.append(path)
    else:
        dtype = np.dtype(np.int64) if isinstance(kind, Struct) else np.dtype(object)
        name = f".{path}" if path in STORED else path
        extent.fields[name] = kind.dtype if isinstance(kind, Primitive) else dtype


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
