"""Message types, parsed from the definition text that a bag carries."""

import re
from collections.abc import Iterator

import numpy as np

from koop_bag.errors import BagError
from koop_core.cdr import Array, MessageType, Primitive, Struct, Text

_BUILTIN: dict[str, Primitive | Text] = {
    name: Primitive(np.dtype(code))
    for name, code in {
        "bool": "?",
        "byte": "u1",
        "char": "u1",  # ROS 2's char is an unsigned byte
        "int8": "i1",
        "uint8": "u1",
        "int16": "<i2",
        "uint16": "<u2",
        "int32": "<i4",
        "uint32": "<u4",
        "int64": "<i8",
        "uint64": "<u8",
        "float32": "<f4",
        "float64": "<f8",
    }.items()
} | {"string": Text(), "wstring": Text(wide=True)}
_FIELD = re.compile(
    r"^\s*(?P<type>[A-Za-z]\w*(?:/\w+)*)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$"
)
_MAX_DEPTH = 50  # types inside of types
_MAX_FIELDS = 20_000  # with the fields of types inside; the largest messages in use have hundreds


def parse_definition(type_name: str, text: str) -> Struct:
    """Return the type of a topic, `pkg/msg/Type`.

    The text is the root definition, then its dependencies after lines of `=`, each opened by `MSG:
    pkg/Type`.
    """
    package, _, name = type_name.replace("/msg/", "/").partition("/")
    root, *others = re.split(r"^={80}$\n", text, flags=re.MULTILINE)
    definitions = {f"{package}/{name}": root}
    for part in others:
        head, _, body = part.partition("\n")
        definitions[head.removeprefix("MSG:").strip().replace("/msg/", "/")] = body
    return _Parser(definitions).struct(f"{package}/{name}")[0]


def has_step(type_name: str, text: str) -> bool:
    """Return whether messages of a type begin with `std_msgs/Header` and `uint64 step`."""
    match parse_definition(type_name, text).fields:
        case ((_, Struct(name="std_msgs/Header")), ("step", kind), *_):
            return kind == _BUILTIN["uint64"]
    return False


def message_types(text: str, package: str) -> Iterator[str]:
    """Yield the full names of the message types in one definition of a package."""
    for _, name, _ in _fields(text, package):
        if name not in _BUILTIN:
            yield name


def _fields(text: str, package: str) -> Iterator[tuple[str, str, str | None]]:
    """Name, type and brackets of the fields of one definition; a message type by its full name."""
    for line in text.splitlines():
        match = _FIELD.match(line)
        if match is None or match["rest"].startswith("="):  # comment, blank line or constant
            continue
        kind = match["type"].replace("/msg/", "/")
        if kind == "Header":  # the one type that ROS lets stand without its package
            kind = "std_msgs/Header"
        elif kind not in _BUILTIN and "/" not in kind:
            kind = f"{package}/{kind}"
        yield match["name"], kind, match["array"]


class _Parser:
    """Makes types of their definitions, each once."""

    def __init__(self, definitions: dict[str, str]) -> None:
        self._definitions = definitions
        self._made: dict[str, tuple[Struct, int]] = {}
        self._open: list[str] = []  # types that are being made: each holds the next one

    def struct(self, name: str) -> tuple[Struct, int]:
        """Return the type of a full name, and the number of its fields."""
        if name in self._made:
            return self._made[name]
        if name not in self._definitions:
            raise BagError(f"the bag's message definition lacks {name}")
        if name in self._open or len(self._open) == _MAX_DEPTH:
            raise BagError(
                f"the bag's message definition is endless: {self._open[0]} nests too deep"
            )
        self._open.append(name)
        count = 0
        fields: list[tuple[str, MessageType]] = []
        for field, kind, brackets in _fields(self._definitions[name], name.partition("/")[0]):
            builtin = _BUILTIN.get(kind)
            element, size = (builtin, 1) if builtin else self.struct(kind)
            fields.append((field, _array(element, brackets)))
            count += size
        if count > _MAX_FIELDS:
            raise BagError(
                f"the bag's message definition {name} has more than {_MAX_FIELDS} fields"
            )
        self._open.pop()
        # A message without fields is serialized as one byte: DDS knows no empty structures.
        nothing = ("structure_needs_at_least_one_member", _BUILTIN["uint8"])
        self._made[name] = Struct(name, tuple(fields) or (nothing,)), max(count, 1)
        return self._made[name]


def _array(element: MessageType, brackets: str | None) -> MessageType:
    if not brackets:
        return element
    size = brackets.strip("[]")
    if not size.isdigit():
        return Array(element, None)
    if not 0 < len(size) <= 10 or int(size) == 0:
        raise BagError(f"the bag's message definition has an array of {size:.20} elements")
    return Array(element, int(size))


def leaf_fields(kind: MessageType, prefix: str = "") -> list[str]:
    """Return the names of the fields that read as columns, in order.

    They are numbers, strings, times, and arrays of numbers.
    """
    if isinstance(kind, Struct) and not (kind.is_stamp and prefix):
        inner = [
            leaf_fields(field, f"{prefix}.{name}" if prefix else name)
            for name, field in kind.fields
        ]
        return [name for names in inner for name in names]
    if isinstance(kind, Array) and not isinstance(kind.element, Primitive):
        return []  # one column per element: `status[0].level`
    return [] if isinstance(kind, Text) and kind.wide else [prefix]
