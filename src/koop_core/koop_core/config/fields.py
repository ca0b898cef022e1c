"""Field expressions such as ``position[0]``, which take numbers out of any message.

Pure: a message is an object with attributes. Nothing of the text is ever executed; a name is
looked up only if it is one that a message definition can have, so no method or private attribute
can be reached.

    source = topic ":" field { "," field }        /joint_states:position[0],velocity[0]
    sources = source { "," source }               /rig/kp:data,/rig/kd:data
    field  = part { "." part }                    twist.linear.x
    part   = name [ "[" index "]" ]               data[3]
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import islice
from numbers import Integral, Real
from typing import Any, NamedTuple

from koop_core.config.parameter import ConfigError

_PART = re.compile(r"([A-Za-z](?:_?[A-Za-z0-9])*)(?:\[(0|[1-9][0-9]{0,5})\])?", re.ASCII)
_TOPIC = re.compile(r"[~/]?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*", re.ASCII)
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*", re.ASCII)
MAX_DEPTH = 20
MAX_FIELDS = 64  # as many states as a model can have

Path = tuple[tuple[str, int | None], ...]


class Source(NamedTuple):
    """A topic and fields of its messages, in order."""

    topic: str
    fields: tuple[Path, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The fields as text."""
        return tuple(map(format_field, self.fields))

    def __str__(self) -> str:
        return f"{self.topic}:{','.join(self.names)}"


def parse_field(text: str) -> Path:
    """Return the steps from a message to a number, or raise ConfigError.

    >>> parse_field("pose.position.x")
    (('pose', None), ('position', None), ('x', None))
    """
    parts = text.strip().split(".", MAX_DEPTH)
    matches = [_PART.fullmatch(part) for part in parts]
    if len(parts) > MAX_DEPTH or not all(matches):
        raise ConfigError(
            f"{_short(text)} is not a field: write, for example, x, position[0] or twist.linear.x"
        )
    return tuple((m[1], int(m[2]) if m[2] else None) for m in matches if m)


def format_field(path: Path) -> str:
    """Return the text of a path; the opposite of :func:`parse_field`."""
    return ".".join(name if index is None else f"{name}[{index}]" for name, index in path)


def parse_source(text: str) -> Source:
    """Return the topic and the fields of ``topic:field,field``, or raise ConfigError.

    The one grammar of what is measured and what is commanded: in rig files, node parameters and
    the options ``--measured`` and ``--command``.

    >>> parse_source("/joint_states:position[0],velocity[0]").names
    ('position[0]', 'velocity[0]')
    """
    topic, colon, fields = text.strip().partition(":")
    if not colon or not _TOPIC.fullmatch(topic):
        raise ConfigError(
            f"{_short(text)} is not a source: write /topic:field or /topic:field,field, "
            "such as /joint_states:position[0],velocity[0]"
        )
    names = fields.split(",", MAX_FIELDS)
    if len(names) > MAX_FIELDS:
        raise ConfigError(f"more than {MAX_FIELDS} fields")
    source = Source(topic, tuple(parse_field(name) for name in names))
    if len(set(source.fields)) < len(source.fields):
        raise ConfigError(f"{_short(text)} names a field twice")
    return source


def parse_sources(text: str) -> tuple[Source, ...]:
    """Return the sources of a text, of a topic each, or raise ConfigError.

    >>> [str(source) for source in parse_sources("/rig/gains:kp,kd, /rig/mass:data")]
    ['/rig/gains:kp,kd', '/rig/mass:data']
    """
    sources = tuple(parse_source(part) for part in re.split(r",(?=[^,:]*:)", text))
    if len({source.topic for source in sources}) < len(sources):
        raise ConfigError(f"{_short(text)} names a topic twice")
    return sources


def check_topic(text: str) -> str:
    """Return a topic name or raise ConfigError."""
    if not _TOPIC.fullmatch(text):
        raise ConfigError(f"{_short(text)} is not a topic name: write, for example, /rig/theta")
    return text


def check_type(text: str) -> str:
    """Return ``pkg/msg/Type`` or raise ConfigError."""
    if not _TYPE.fullmatch(text):
        raise ConfigError(f"{_short(text)} is not a message type: write, for example, pkg/msg/Type")
    return text


def check_fields(fields: tuple[Path, ...], message: Any) -> None:
    """Raise ConfigError unless a message of this kind has all fields.

    Its arrays may be empty: their elements are then not looked at.
    """
    for path in fields:
        value = message
        for name, index in path:
            if not _has(value, name):
                raise ConfigError(f"{type(value).__name__} has no field '{name}'{_offer(value)}")
            value = getattr(value, name)
            if (index is not None) != hasattr(value, "__len__") or isinstance(value, str):
                wanted = "needs an index" if index is None else "takes no index"
                raise ConfigError(f"{type(message).__name__}: '{name}' {wanted}")
            if index is not None:
                if index >= len(value):
                    break  # not known before the first message
                value = value[index]
        else:
            if not isinstance(value, Real):
                raise ConfigError(f"{type(message).__name__}: '{name}' is not a number")


def read_field(path: Path, message: Any) -> float:
    """Return a number of a message; NaN if there is none, as at the end of a short array."""
    value = message
    for name, index in path:
        value = getattr(value, name, None)
        if index is not None:
            try:
                value = value[index]  # type: ignore[index]
            except (IndexError, TypeError, KeyError):
                return math.nan
    return float(value) if isinstance(value, Real) else math.nan


def write_field(path: Path, message: Any, value: float) -> None:
    """Set a number of a message, rounded where it takes whole ones, or raise ConfigError.

    Short arrays are filled with zeros.
    """
    *above, (name, index) = path
    for part, place in above:
        message = getattr(message, part)
        message = message if place is None else message[place]
    field = getattr(message, name)
    try:
        if index is None:
            setattr(message, name, round(value) if isinstance(field, Integral) else float(value))
            return
        while len(field) <= index:
            field.append(0)
        field[index] = round(value) if isinstance(field[index], Integral) else float(value)
    except (AttributeError, TypeError, IndexError):
        raise ConfigError(f"{type(message).__name__}: '{name}' takes no number there") from None


def numbers_of(message: Any) -> list[Path]:
    """Return all fields of a message that are numbers, up to :data:`MAX_FIELDS`.

    What says when and not what was measured is left out: headers, stamps, steps, flags.
    """
    return list(islice(_numbers_of(message, ()), MAX_FIELDS))


def _numbers_of(value: Any, above: Path) -> Iterator[Path]:
    for name in getattr(value, "get_fields_and_field_types", dict)():
        item = getattr(value, name)
        if name in ("header", "stamp", "step", "seq", "layout") or isinstance(item, bool | str):
            continue
        if isinstance(item, Real):
            yield (*above, (name, None))
        elif hasattr(item, "get_fields_and_field_types") and len(above) < MAX_DEPTH:
            yield from _numbers_of(item, (*above, (name, None)))
        elif hasattr(item, "__len__") and len(item) and not isinstance(item, bytes):
            for i in range(min(len(item), MAX_FIELDS)):
                if isinstance(item[i], Real):
                    yield (*above, (name, i))
                else:
                    yield from _numbers_of(item[i], (*above, (name, i)))


def _has(message: Any, name: str) -> bool:
    field_types = getattr(message, "get_fields_and_field_types", None)
    return name in field_types() if field_types is not None else hasattr(message, name)


def _offer(message: Any) -> str:
    field_types = getattr(message, "get_fields_and_field_types", dict)
    return f" (it has {', '.join(field_types())})" if field_types() else ""


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")
