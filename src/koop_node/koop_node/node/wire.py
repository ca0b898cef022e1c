"""Messages as DDS carries them, without rclpy's conversion: four fifths of what a message costs.

A :class:`Codec` is made of a message class once, at the start. It knows numbers, strings, sequences
of numbers and messages of those; where a number lies depends on nothing but the length words before
it, so messages of equal lengths share one layout, and one ``struct`` call reads or writes them all.

Objects have the fields of the message class and nothing else: no field checks its type. What a
codec writes is what rclpy's own serialiser writes, to the byte.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from dataclasses import make_dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.cdr import Array, CdrError, MessageType, Primitive, Struct, Text, Walk

LITTLE = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR, little endian. Alignment counts from its end."""

FORMATS = {
    "boolean": "?", "octet": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float": "f", "double": "d",
}  # fmt: skip


class WireError(ValueError):
    """A message cannot be read, or a message class has fields that a codec does not know."""


class Leaf(NamedTuple):
    """A field that holds no other ones."""

    path: str
    """Dotted names from the message."""
    format: str
    """Code of :mod:`struct` for the number or for each element."""
    kind: str
    """``number``, ``text`` or ``sequence``."""

    @property
    def type(self) -> MessageType:
        """Its type in CDR."""
        if self.kind == "text":
            return Text()
        number = Primitive(np.dtype(f"<{self.format}"))
        return number if self.kind == "number" else Array(number, None)


class Piece(NamedTuple):
    """A length word (whose path is empty) or a value, and where it lies in a message."""

    path: str
    item: str
    begin: int
    end: int


class Places(NamedTuple):
    """Where the values of a message lie, and of all others whose length words are the same."""

    at: dict[str, int]
    """Offset of each number, text or first element from the message's begin, by dotted name."""
    guards: NDArray[np.int64]
    """Shape (G, 2): offset and value of each length word."""
    size: int
    """Bytes of the message."""


class Packing(NamedTuple):
    """Where the fields lie in all messages whose length words are the same."""

    packer: struct.Struct
    lengths: tuple[int, ...]
    places: Places


class Codec:
    """Reads and writes one type of message, of a class that the interface generators made.

    Raises WireError if it has fields of other kinds than those named above.
    """

    def __init__(self, message_class: Any) -> None:
        self.name = message_class.__name__
        leaves = list(_leaves(message_class))
        self._leaves = leaves
        self._type = Struct(self.name, tuple((leaf.path, leaf.type) for leaf in leaves))
        self._layouts: dict[tuple[int, ...], Packing] = {}
        self._last = self._layout(tuple(1 for leaf in leaves if leaf.kind != "number"))
        made = _compiled(message_class, leaves)
        self._build, self._lengths, self._encode = made["build"], made["lengths"], made["encode"]
        self._empty = self.encode(message_class())

    def new(self) -> Any:
        """Return an empty message."""
        return self.decode(self._empty)

    def encode(self, message: Any) -> bytes:
        """Return a message, of this codec or of the message class, as DDS carries it."""
        return self._encode(message, self._layout)

    def decode(self, data: bytes) -> Any:
        """Return the message that DDS carried.

        Raises WireError if it is cut short, in another encoding, or holds text that is not UTF-8.
        """
        layout = self._last
        if data[:4] != LITTLE or len(data) < layout.packer.size:
            layout = self._last = self._find(data)
        values = layout.packer.unpack_from(data)
        if self._lengths(values) != layout.lengths:
            layout = self._last = self._find(data)
            values = layout.packer.unpack_from(data)
        try:
            return self._build(values)
        except UnicodeDecodeError as error:
            raise WireError(f"a {self.name} holds text that is not UTF-8: {error}") from None

    def places(self, data: bytes) -> Places:
        """Return where the values of a message lie; WireError as :meth:`decode`."""
        return self._find(data).places

    def _layout(self, lengths: tuple[int, ...]) -> Packing:
        if lengths not in self._layouts:
            if len(self._layouts) > 100:  # lengths that change for ever must not fill the memory
                self._layouts.clear()
            self._layouts[lengths] = self._pack(lengths)
        return self._layouts[lengths]

    def _pack(self, lengths: tuple[int, ...]) -> Packing:
        text, end, at, words = "<4s", len(LITTLE), {}, []
        for piece in self._pieces(lengths):
            pad = piece.begin - end
            text += f"{pad}x{piece.item}" if pad else piece.item
            end = piece.end
            if piece.path:
                at[piece.path] = piece.begin
            else:
                words.append(piece.begin)
        guards = np.array(list(zip(words, lengths, strict=True)), np.int64).reshape(-1, 2)
        return Packing(struct.Struct(text), lengths, Places(at, guards, end))

    def _pieces(self, lengths: tuple[int, ...]) -> Iterator[Piece]:
        end, left = len(LITTLE), iter(lengths)
        for leaf in self._leaves:
            size = struct.calcsize(f"<{leaf.format}")
            parts = [(leaf.path, leaf.format, size, size)]
            if leaf.kind != "number":
                length = next(left)
                whole = length * size
                parts = [("", "I", 4, 4), (leaf.path, f"{whole}s", whole, size if length else 1)]
            for path, item, taken, alignment in parts:
                begin = end + -(end - len(LITTLE)) % alignment
                end = begin + taken
                yield Piece(path, item, begin, end)

    def _find(self, data: bytes) -> Packing:
        """Walk over a message and return its layout."""
        if data[:2] != LITTLE[:2]:
            raise WireError(f"a {self.name} is not in little-endian CDR")
        try:
            walk = Walk(data)
            walk.visit(self._type)
        except CdrError as error:
            raise WireError(f"a {self.name} is {error}") from None
        return self._layout(tuple(length for _, length in walk.guards))


@cache
def codec(message_class: Any) -> Codec:
    """Return the codec of a message class; raise WireError if it can have none."""
    return Codec(message_class)


def _leaves(message_class: Any, prefix: str = "") -> Iterator[Leaf]:
    for name, kind in message_class.get_fields_and_field_types().items():
        path = f"{prefix}{name}"
        element = kind.removeprefix("sequence<").removesuffix(">")
        if kind in FORMATS:
            yield Leaf(path, FORMATS[kind], "number")
        elif kind == "string":
            yield Leaf(path, "B", "text")
        elif kind == f"sequence<{element}>" and FORMATS.get(element, "?") != "?":
            yield Leaf(path, FORMATS[element], "sequence")
        elif "/" in kind and kind == element:
            yield from _leaves(_class_of(message_class, name), f"{path}.")
        else:
            raise WireError(f"{message_class.__name__}.{name}: no codec for a field {kind}")


def _class_of(message_class: Any, name: str) -> Any:
    return type(getattr(message_class(), name))


def _positions(leaves: list[Leaf]) -> Iterator[tuple[int, Leaf]]:
    """Yield the position of each leaf in the values, without the encapsulation."""
    index = 0
    for leaf in leaves:
        yield index, leaf
        index += 1 if leaf.kind == "number" else 2


def _compiled(message_class: Any, leaves: list[Leaf]) -> dict[str, Any]:
    """Return functions made for a type of message.

    ``build(values)`` returns the one with the values of a layout, ``lengths(values)`` its length
    words, ``encode(message, layout)`` its bytes.
    """
    read = {
        leaf.path: {
            "number": f"v[{index + 1}]",
            "text": f"text(v[{index + 2}])",
            "sequence": f"array({leaf.format!r}, v[{index + 2}])",
        }[leaf.kind]
        for index, leaf in _positions(leaves)
    }
    space: dict[str, Any] = {
        "LITTLE": LITTLE,
        "array": array,
        "text": lambda chunk: chunk[:-1].decode() if len(chunk) > 1 else "",
    }

    def expression(made: Any, prefix: str) -> str:
        names = list(made.get_fields_and_field_types())
        inner = [
            read.get(f"{prefix}{name}") or expression(_class_of(made, name), f"{prefix}{name}.")
            for name in names
        ]
        label = f"{made.__name__}_{prefix.replace('.', '_')}"
        space[label] = make_dataclass(label, names, repr=False, eq=False, slots=True)
        return f"{label}({', '.join(inner)})"

    build = expression(message_class, "")
    lengths = " ".join(f"v[{n + 1}]," for n, leaf in _positions(leaves) if leaf.kind != "number")
    source = (
        f"def build(v):\n    return {build}\n"
        f"def lengths(v):\n    return ({lengths})\n" + _encoder(leaves)
    )
    # as dataclasses and namedtuple do it: a call for every field would cost as much as rclpy
    exec(compile(source, f"<codec of {message_class.__name__}>", "exec"), space)
    return space


def _encoder(leaves: list[Leaf]) -> str:
    """Return the source of what packs a message: its text and sequences first, for the layout."""
    lines, lengths, packed = [], [], ["LITTLE"]
    made = {"": "m"}  # the messages in it, by path
    for number, leaf in enumerate(leaves):
        *outer, name = leaf.path.split(".")
        holder = ""
        for part in outer:
            path = f"{holder}.{part}"
            if path not in made:
                label = f"m{len(made)}"
                lines.append(f"{label} = {made[holder]}.{part}")
                made[path] = label
            holder = path
        value = f"{made[holder]}.{name}"
        if leaf.kind == "number":
            packed.append(value)
            continue
        chunk, length = f"c{number}", f"n{number}"
        if leaf.kind == "text":
            lines.append(f"{chunk} = {value}.encode() + b'\\0'")
            lines.append(f"{length} = len({chunk})")
        else:
            size = struct.calcsize(f"<{leaf.format}")
            lines.append(f"{chunk} = array({leaf.format!r}, {value}).tobytes()")
            lines.append(f"{length} = len({chunk}) // {size}")
        lengths.append(f"{length},")
        packed += [length, chunk]
    lines.append(f"return layout(({' '.join(lengths)})).packer.pack({', '.join(packed)})")
    return "def encode(m, layout):\n" + "".join(f"    {line}\n" for line in lines)
