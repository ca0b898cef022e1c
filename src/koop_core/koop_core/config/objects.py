"""Dataclasses and named tuples from the content of a YAML or JSON file, and back."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from enum import Enum
from inspect import Parameter, signature
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from koop_core.config.parameter import ConfigError, mapping, refuse_unknown, spec_of

T = TypeVar("T")


def to_json(value: Any) -> Any:
    """Return an object as JSON; an infinite number, which JSON has not, is a text."""
    if is_dataclass(value):
        return {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return to_json(value._asdict())
    if isinstance(value, dict):
        return {name: to_json(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value


def parse(kind: type[T], content: Any, where: str) -> T:
    """Return the object of a class that the content of a file describes.

    The class is a dataclass or named tuple with annotated fields: numbers, strings, members of an
    Enum, mappings, lists, tuples and arrays of them, or others of its sort. ``where`` begins an
    error message.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a key is unknown (the nearest known one is named) or missing, or a value does not fit.

    Examples
    --------
    >>> from typing import NamedTuple
    >>> class Band(NamedTuple):
    ...     low: float
    ...     high: float = 1.0
    >>> parse(Band, {"low": "-inf"}, "a band")
    Band(low=-inf, high=1.0)
    """
    content = mapping(content, where)
    hints, known = get_type_hints(kind), signature(kind).parameters
    refuse_unknown(content, known, "key", where)
    of_knobs = {
        item.name: tuple[float, ...]
        for item in (fields(kind) if is_dataclass(kind) else ())
        if "spec" in item.metadata and spec_of(item).per_knob
        and isinstance(content.get(item.name), list | tuple)
    }  # fmt: skip
    hints |= of_knobs
    values = {key: convert(hints[key], content[key], f"{where}: {key}") for key in content}
    for name, item in known.items():
        if name not in values and item.default is Parameter.empty:
            raise ConfigError(f"{where}: '{name}' is missing")
    try:
        return kind(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def convert(hint: Any, value: Any, where: str) -> Any:
    """Return ``value`` as the annotation ``hint`` wants it; raise ConfigError if it cannot be."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is UnionType:  # such as Band | None
        return None if value is None else convert(args[0], value, where)
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return parse(hint, value, where)
    if origin in (list, tuple, np.ndarray):
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where}: expected a list, got {value!r:.60}")
        if origin is np.ndarray:
            return _as_array(value, where)
        kinds = args if origin is tuple and args[-1] is not Ellipsis else args[:1] * len(value)
        if len(kinds) != len(value):
            raise ConfigError(f"{where}: expected {len(kinds)} values, got {len(value)}")
        pairs = enumerate(zip(kinds, value, strict=True))
        return origin(convert(kind, item, f"{where}[{i}]") for i, (kind, item) in pairs)
    if origin is dict:
        items = mapping(value, where).items()
        return {key: convert(args[1], item, f"{where}.{key}") for key, item in items}
    if hint is Any:
        return value
    if issubclass(hint, Enum):
        try:
            return hint(value)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from None
    if hint is float and (type(value) is int or value in ("inf", "-inf")):
        try:
            return float(value)
        except OverflowError:
            raise ConfigError(f"{where}: the number is too large") from None
    if type(value) is not hint:
        raise ConfigError(f"{where}: expected {hint.__name__}, got {value!r}")
    return value


def _as_array(value: Any, where: str) -> Any:
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f"{where}: expected numbers, got {value!r:.60}") from None
