"""The rig file: topics, limits and times that messages of a rig cannot tell."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_core.config.describe import FIXED, WIDTH, allowed
from koop_core.config.fields import Source, parse_source
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import (
    ConfigError,
    mapping,
    parameter,
    refuse_unknown,
    spec_of,
)
from koop_core.config.parameter_file import as_yaml
from koop_core.config.yaml_file import LinedLoader, read_yaml
from koop_guard.config import GuardConfig, RigLimits
from koop_tune.rig.scale import Scale

STATE, STATE_TYPE = "/state", "koop_msgs/msg/MeasuredState"
THETA, THETA_TYPE = "/theta", "koop_msgs/msg/ControlInput"
HEAD = """\
# A rig, for 'koop check' and 'koop excite': what its messages cannot tell. Times are seconds of the
# rig's own time; theta is in the rig's own unit.
"""


@dataclass(frozen=True)
class RigFile(RigLimits):
    """One rig, as its file describes it: its limits, and what is wanted of it."""

    weights: tuple[float, ...] = parameter(
        (), "how much each channel counts in the amplitude, in units of its own motion; []: alike"
    )
    objective: str = parameter(
        "minimise", "what is wanted of the oscillation", choices=("minimise", "maximise")
    )
    time: float = parameter(1800.0, "longest time that the excitation may take", unit="s", low=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_counts("weights")
        if self.bounded is not None and self.count > 1:
            raise ConfigError(
                f"constraint = {self.constraint!r}: how far a signal's bound lets theta go is "
                f"found of one knob only, the command has {self.count}: keep only lines between "
                "knobs"
            )

    def knob(self, i: int, **others: Any) -> RigFile:
        """Return the rig file of one knob alone, with ``others`` changed."""
        fields_of = [Source(c.topic, (path,)) for c in self.commands for path in c.fields]
        own = {"command": str(fields_of[i]), "constraint": "" if self.lines else self.constraint}
        return super().knob(i, **{**own, **others})

    def room(self, i: int, theta: Sequence[float]) -> tuple[float, float]:
        """Return the limits that lines leave a knob while the others are at a theta."""
        low, high = self.each("theta_min")[i], self.each("theta_max")[i]
        for line in self.lines:
            if (weight := line.weights[i]) != 0.0:
                end = theta[i] - line.excess(theta) / weight
                low, high = (low, min(high, end)) if weight > 0.0 else (max(low, end), high)
        return low, high

    def section(self, i: int, theta: Sequence[float]) -> RigFile:
        """Return the rig file of a knob that starts at a theta, its limits the room that it has.

        Without any they are its own.
        """
        low, high = self.room(i, theta)
        if low >= high:
            low, high = self.each("theta_min")[i], self.each("theta_max")[i]
        start, safe = (min(max(v, low), high) for v in (theta[i], self.each("theta_safe")[i]))
        limits = {"theta_min": low, "theta_max": high, "theta_start": start, "theta_safe": safe}
        return self.knob(i, **limits)

    @property
    def measured_source(self) -> Source:
        """Topic, by its full name, and fields of the measured channels."""
        return _full(parse_source(self.measured))

    @property
    def command_sources(self) -> tuple[Source, ...]:
        """Topics, by their full names, and fields of the command."""
        return tuple(map(_full, self.commands))

    @property
    def command_topics(self) -> str:
        """These topics in words."""
        return " and ".join(source.topic for source in self.command_sources)

    @property
    def speaks_state(self) -> bool:
        """Whether the rig itself publishes what the lifter listens to, in its order.

        A rig with another message type on that topic is refused where the graph is known.
        """
        return self.measured_source == parse_source(state_source(len(self.names)))

    @property
    def lifter_input(self) -> dict[str, float | str]:
        """The lifter's parameters that say what it hears, and how often."""
        values: dict[str, float | str] = {"dt": self.dt}
        values["measured"] = "" if self.speaks_state else self.measured
        values["constraint"] = self.constraint if self.bounded else ""
        return {name: value for name, value in values.items() if value}

    @property
    def guard(self) -> GuardConfig:
        """Limits that the guard of this rig keeps."""
        return GuardConfig(**{item.name: getattr(self, item.name) for item in fields(RigLimits)})

    @property
    def span(self) -> float:
        """Range of theta."""
        return self.theta_max - self.theta_min

    @property
    def scale(self) -> Scale:
        """Positions in theta's range."""
        return Scale(self.theta_min, self.theta_max)

    @property
    def scales(self) -> list[Scale]:
        """Positions in the range of each knob."""
        return list(map(Scale, self.each("theta_min"), self.each("theta_max")))

    def u(self, theta: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the knobs, n in the last axis."""
        each = np.moveaxis(np.asarray(theta, np.float64), -1, 0)
        return np.stack([s.u(v) for s, v in zip(self.scales, each, strict=True)], axis=-1)

    def theta_at(self, u: ArrayLike) -> tuple[float, ...]:
        """Return theta of each knob at positions, shape (n,)."""
        return tuple(map(Scale.theta_at, self.scales, np.asarray(u).tolist()))

    @property
    def theta_lines(self) -> str:
        """The lines between knobs as the controller's parameter ``constraint``."""
        return "; ".join(
            " ".join(f"{a:+.15g} theta[{i}]" for i, a in enumerate(line.weights) if a != 0.0)
            + f" <= {line.bound:.15g}"
            for line in self.lines
        )

    def spell(self, name: str, spec: str = "g") -> str:
        """Return a parameter of each knob in words."""
        return format_knobs(self.each(name), spec)

    @property
    def u_start(self) -> float:
        """Position of theta before any command."""
        return float(self.scale.u(np.array(self.theta_start)))

    @property
    def sense(self) -> float:
        """+1 if little of the oscillation is wanted, else -1."""
        return 1.0 if self.objective == "minimise" else -1.0


REQUIRED = ("measured", "command", "dt", "theta_min", "theta_max", "theta_rate", "theta_start",
            "theta_safe")  # fmt: skip


def read(path: str | Path) -> RigFile:
    """Read a rig file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be used; names file and line.
    """
    if not Path(path).exists():
        raise ConfigError(f"{path}: there is no such file; koop commission --new {path} writes one")
    content = read_yaml(path, LinedLoader)
    lines: Mapping[str, int] = getattr(content, "lines", {})
    try:
        values = mapping(content, "the file")
        refuse_unknown(values, [item.name for item in fields(RigFile)], "key")
        lacking = set(REQUIRED) - values.keys()
        missing = [item for item in fields(RigFile) if item.name in lacking]
        if len(missing) == 1:
            raise ConfigError(f"'{missing[0].name}' is missing: {spec_of(missing[0]).description}")
        if missing:
            names = ", ".join(item.name for item in missing)
            raise ConfigError(f"these are missing: {names}; koop commission --new asks for each")
        return RigFile(**values)
    except ConfigError as error:
        text = str(error)
        words = re.match(r"(?:unknown key ')?(\w+)", text)
        line = lines.get(words[1]) if words else None
        place = f"{path}:{line}" if line is not None else f"{path}"
        raise ConfigError(f"{place}: {text}") from None


def written(rig: RigFile) -> str:
    """Return the text of a rig file, each value with its meaning above it."""
    lines = [HEAD.rstrip("\n")]
    values = asdict(rig)
    for item in fields(RigFile):
        text = f"{spec_of(item).description} ({allowed(item).removesuffix(FIXED)})"
        lines += ["", *textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ")]
        lines.append(f"{item.name}: {as_yaml(values[item.name])}")
    return "\n".join(lines) + "\n"


def write(rig: RigFile, path: Path) -> None:
    """Write a rig file.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there is a file already.
    """
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(written(rig))
    except FileExistsError:
        raise ConfigError(f"{path} is there already: name another file") from None


def state_source(channels: int) -> str:
    """Return the states of a loop as topic:field,field.

    >>> state_source(2)
    '/state:x[0],x[1]'
    """
    return f"{STATE}:{','.join(f'x[{i}]' for i in range(channels))}"


def _full(source: Source) -> Source:
    return source._replace(topic="/" + source.topic.lstrip("~/"))


def as_values(rig: RigFile) -> dict[str, Any]:
    """Return the values as JSON."""
    return {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(rig).items()}
