"""Dataclasses and named tuples as JSON objects, by their fields, and back."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")


def to_json(value: Any) -> Any:
    """Return an object as JSON; an infinite number is null."""
    if is_dataclass(value):
        return {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: to_json(item) for name, item in value._asdict().items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {name: to_json(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def from_json(kind: type[T], value: Any) -> T:
    """Return an object of a class from JSON.

    Raises
    ------
    KeyError, TypeError, ValueError
        If it does not describe one.

    Examples
    --------
    >>> from typing import NamedTuple
    >>> class Band(NamedTuple):
    ...     low: float
    ...     high: float
    >>> from_json(Band, to_json(Band(1.0, math.inf)))
    Band(low=1.0, high=inf)
    """
    return cast(T, _read(kind, value))


def _read(kind: Any, value: Any) -> Any:
    of, origin = get_args(kind), get_origin(kind)
    if type(None) in of:
        return None if value is None else _read(of[0], value)
    if origin is tuple and of[-1] is not Ellipsis:
        return tuple(_read(*pair) for pair in zip(of, value, strict=True))
    if origin in (list, tuple):
        return origin(_read(of[0], item) for item in value)
    if origin is np.ndarray:
        return np.array(value, np.float64)
    if kind is float:
        return math.inf if value is None else float(value)
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        hints = get_type_hints(kind)
        return cast(Any, kind)(**{name: _read(hints[name], v) for name, v in dict(value).items()})
    return value
