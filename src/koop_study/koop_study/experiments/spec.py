"""Experiment files: YAML in, checked dataclasses out.

A file names its kind in ``experiment:`` and sets fields of that kind's configuration class; a
mapping ``quick:`` replaces some of them for ``koop study --quick``.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from koop_core.config.parameter import ConfigError, mapping, refuse_unknown

T = TypeVar("T")


@dataclass(frozen=True)
class Seeds:
    """``count`` consecutive seeds from ``first`` on."""

    first: int
    count: int

    def __post_init__(self) -> None:
        if self.first < 0 or not 1 <= self.count <= 100_000:
            raise ConfigError(f"seeds from {self.first}, {self.count} of them: need at least one")

    def list(self) -> list[int]:
        """Return the seeds."""
        return [*range(self.first, self.first + self.count)]


def parse(kind: type[T], content: Any, where: str) -> T:
    """Build a configuration dataclass from YAML content.

    Parameters
    ----------
    kind : type
        A frozen dataclass with annotated fields: numbers, strings, mappings, tuples of them, or
        other dataclasses.
    content : object
        Content of the YAML file.
    where : str
        Begin of an error message.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a key is unknown (the nearest known one is named) or missing, or a value does not fit.
    """
    content = mapping(content, where)
    hints = get_type_hints(kind)
    by_name = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
    refuse_unknown(content, by_name, "key", where)
    values = {key: convert(hints[key], content[key], f"{where}: {key}") for key in content}
    for name, item in by_name.items():
        if name not in values and item.default is MISSING and item.default_factory is MISSING:
            raise ConfigError(f"{where}: '{name}' is missing")
    try:
        return kind(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def convert(hint: Any, value: Any, where: str) -> Any:
    """Return ``value`` as the annotation ``hint`` wants it; raise ConfigError if it cannot be."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is UnionType:  # such as Seeds | None, where absent is None
        return convert(args[0], value, where)
    if is_dataclass(hint):
        return parse(hint, value, where)  # type: ignore[arg-type]
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where}: expected a list, got {value!r}")
        return tuple(convert(args[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if origin is dict:
        items = mapping(value, where).items()
        return {key: convert(args[1], item, f"{where}.{key}") for key, item in items}
    if hint is Any:
        return value
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint:
        raise ConfigError(f"{where}: expected {hint.__name__}, got {value!r}")
    return value
