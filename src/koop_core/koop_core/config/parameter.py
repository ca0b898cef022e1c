"""Self-validating configuration classes. Pure: imports nothing of ROS.

A configuration is a frozen dataclass whose fields are made by :func:`parameter`. The metadata of a
field is the one place where its unit, range and meaning are written; validation, ROS parameter
descriptors (``koop_node.node.parameters``) and the documentation all read it.
"""

from __future__ import annotations

import difflib
import functools
import math
from collections import namedtuple
from collections.abc import Iterable, Mapping
from dataclasses import Field, dataclass, field, fields
from numbers import Integral, Real
from typing import Any, TypeVar

from koop_core.errors import InputError

Made = TypeVar("Made")
SIMILAR = 0.7
"""Similarity of two names, 0 to 1, from which on one is taken for the other misspelt."""


class ConfigError(InputError):
    """A configuration value that cannot be used; says which, why and what is allowed."""


@dataclass(frozen=True)
class Spec:
    """Meaning and allowed values of a parameter."""

    description: str
    unit: str = ""
    low: float = -math.inf
    """Inclusive range, as ``high``, of a number or of every element of a list."""
    high: float = math.inf
    choices: tuple[str, ...] = ()
    """Allowed values of a string; empty for any."""
    read_only: bool = False
    """Whether the value cannot change while the node runs."""
    per_knob: bool = False
    """Whether it may also be a list of numbers, one for each knob; see :mod:`.knobs`."""
    origin: str = ""
    """Source of the default: a study, a measurement, a standard; empty where nothing had to."""

    @property
    def constraint(self) -> str:
        """The allowed values in words; empty if there is no constraint."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        unit = f" {self.unit}" if self.unit else ""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{self.low:g} to {self.high:g}{unit}"
        if math.isfinite(self.low):
            return f"at least {self.low:g}{unit}"
        if math.isfinite(self.high):
            return f"at most {self.high:g}{unit}"
        return ""


def parameter(default: Any, description: str, **options: Any) -> Any:
    """Declare one field of a configuration dataclass; the options are fields of :class:`Spec`."""
    return field(default=default, metadata={"spec": Spec(description, **options)})


judged = functools.partial(parameter, origin="judgement")


def spec_of(config_field: Field[Any]) -> Spec:
    """Return the :class:`Spec` of a field made by :func:`parameter`."""
    spec = config_field.metadata["spec"]
    assert isinstance(spec, Spec)
    return spec


@dataclass(frozen=True)
class Settings:
    """Base of configurations: every field is checked against its type and :class:`Spec`.

    An integer is accepted where a float is declared and a list where a tuple is (YAML and ROS
    write them so); the field is then converted. ConfigError is raised on the first field with a
    wrong type, a non-finite number or a value out of range.
    """

    def __post_init__(self) -> None:
        for item in fields(self):
            if "spec" not in item.metadata:  # a configuration of its own, which checked itself
                continue
            value = getattr(self, item.name)
            try:
                listed = spec_of(item).per_knob and not isinstance(value, Real | str)
                converted = _converted(value, () if listed else item.default)
                if listed and len(converted) < 2:
                    (converted,) = converted or (math.nan,)
            except TypeError as error:
                raise ConfigError(f"{item.name}: {error}") from None
            if converted is not value:
                object.__setattr__(self, item.name, converted)
            _check(item.name, converted, spec_of(item))


def _converted(value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise TypeError(f"expected a list of numbers, got {value!r}")
        if type(value) is tuple and all(type(element) is float for element in value):
            return value
        return tuple(_converted(element, 0.0) for element in value)
    wanted = type(default)
    if type(value) is wanted:
        return value
    if wanted is float and isinstance(value, Real) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return math.inf  # which the check refuses
    if wanted is int and isinstance(value, Integral) and not isinstance(value, bool):
        return int(value)
    raise TypeError(f"expected {wanted.__name__}, got {value!r} ({type(value).__name__})")


def _check(name: str, value: Any, spec: Spec) -> None:
    elements = value if isinstance(value, tuple) else (value,)
    for element in elements:
        if isinstance(element, str):
            if spec.choices and element not in spec.choices:
                raise ConfigError(f"{name} = {element!r}: must be {spec.constraint}")
        elif not isinstance(element, bool):
            if isinstance(element, int) and abs(element) >= 2**63:
                raise ConfigError(f"{name}: an integer of more than 64 bits")
            if not math.isfinite(element):
                raise ConfigError(f"{name} = {element}: must be a finite number")
            if not spec.low <= element <= spec.high:
                raise ConfigError(f"{name} = {element:g}: must be {spec.constraint}")


def constants(settings: Made) -> Made:
    """Return the fields of a settings class in a named tuple: constants to a compiled kernel."""
    names = list(type(settings).__dataclass_fields__)  # type: ignore[attr-defined]
    made = namedtuple(type(settings).__name__, names)  # type: ignore[misc]
    return made(*(getattr(settings, name) for name in names))  # type: ignore[return-value]


def mapping(value: Any, where: str) -> dict[str, Any]:
    """Return a mapping by names, or raise ConfigError that says where none is."""
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} must be a mapping, not {value!r:.60}")
    return {str(key): item for key, item in value.items()}


def refuse_unknown(
    unchecked: Iterable[str], allowed: Iterable[str], kind: str = "parameter", where: str = ""
) -> None:
    """Raise ConfigError on the first name that is not known; ``where`` comes before the message.

    >>> refuse_unknown(["dwel"], ["dwell", "tau_f"])
    Traceback (most recent call last):
    ...
    koop_core.config.parameter.ConfigError: unknown parameter 'dwel': did you mean 'dwell'?
    """
    names = list(allowed)
    for name in unchecked:
        if name not in names:
            begin = f"{where}: " if where else ""
            raise ConfigError(f"{begin}unknown {kind} '{name}': {nearest(name, names)}")


def nearest(name: str, allowed: Iterable[str]) -> str:
    """Say which known name is meant by an unknown one, or which there are."""
    names = list(allowed)
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known are {', '.join(names)}"


@dataclass(frozen=True)
class NodeConfig(Settings):
    """Parameters of every node of the loop."""

    autostart: bool = parameter(
        True, "configure and activate by itself at the start", read_only=True
    )
    priority: int = parameter(
        0,
        "real-time priority (SCHED_FIFO) of the node's process, above all ordinary ones, with its "
        "memory locked; 0: none",
        low=0,
        high=99,
        read_only=True,
    )


@dataclass(frozen=True)
class ListenersConfig(Settings):
    """Parameters of every node that others of the loop listen to."""

    listeners: str = parameter(
        "next",
        "nodes that must listen before this one begins: their names, separated by spaces, such as "
        "recorder; 'next' is the next node of the loop, whatever its name is",
        read_only=True,
    )
