"""What theta must keep besides its limits, as rig files and parameters write it. Pure: no ROS.

constraint = part {";" part}
part       = signal | line
signal     = statistic "(" topic ":" field "," window ["s"] ")" "<" bound
statistic  = "rms" | "peak"                      rms(/rig/effort:data, 10 s) < 1.5
line       = sum ("<=" | ">=") sum               kp <= 20 kd; theta[0] + 2 theta[1] <= 3
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from operator import mul
from typing import NamedTuple

from koop_core.config.fields import Source, parse_source
from koop_core.config.parameter import ConfigError, nearest

STATISTICS = ("rms", "peak")
_FORM = re.compile(r"(\w+)\s*\(\s*([^,]+?)\s*,\s*(\S+?)\s*s?\s*\)\s*<\s*(\S+)", re.ASCII)
_LINE = re.compile(r"([^<>=]+)([<>])=([^<>=]+)")
_TERM = re.compile(
    r"\s*([+-]?)\s*((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)?\s*\*?\s*([a-z_/][\w./:[\]]*)?\s*",
    re.ASCII | re.IGNORECASE,
)
FORMS = "write kp <= 20 kd between knobs, or rms(/topic:field, 10 s) < 1.5, or peak in place of rms"


class Constraint(NamedTuple):
    """A statistic of a signal that must stay below a bound."""

    statistic: str
    """``rms``, the root mean square, or ``peak``, the largest magnitude."""
    source: Source
    """Topic and field of the signal."""
    window: float
    """Time over which the statistic is taken [s], of the rig's own time."""
    bound: float
    """What it must stay below, in the signal's unit; above 0."""


class Line(NamedTuple):
    """A line between knobs that theta stays on one side of."""

    text: str
    """As it is written."""
    weights: tuple[float, ...]
    """a of each knob."""
    bound: float
    """b, the largest a . theta."""
    room: float = 0.0
    """Part of b that stays free, for what rounding adds."""

    def excess(self, theta: Sequence[float]) -> float:
        """Return a . theta - b and the room, which is not above 0 where the line is kept."""
        return self.room - self.bound + sum(map(mul, self.weights, theta))

    def with_room(self, low: Sequence[float], high: Sequence[float], share: float) -> Line:
        """Return the line with a share of the largest that its terms are between limits as room."""
        largest = map(max, map(abs, low), map(abs, high))
        return self._replace(
            room=share * (abs(self.bound) + sum(map(mul, map(abs, self.weights), largest)))
        )

    def as_ratio(self) -> Line | None:
        """Return the line between the logarithms of two knobs; None if it limits no ratio."""
        low, *others, high = sorted(self.weights)
        if self.bound != 0.0 or any(others) or not low < 0.0 < high:
            return None
        signs = tuple(math.copysign(a != 0.0, a) for a in self.weights)
        return Line(self.text, signs, math.log(-low / high))


def parse_lines(text: str, names: Sequence[str]) -> tuple[Line, ...]:
    """Return the lines between knobs that a constraint names; raise ConfigError.

    A knob is one of the ``names``, or theta[i].

    >>> parse_lines("rms(/rig/effort:data, 10 s) < 1.5; kp <= 20 kd", ["kp", "kd"])[0].weights
    (1.0, -20.0)
    """
    lines = []
    for part in filter(_is_line, text.split(";")):
        match = _LINE.fullmatch(part)
        if match is None:
            raise ConfigError(f"constraint = {text!r}: {FORMS}")
        left, right = (_parse_sum(side, names, text) for side in match.group(1, 3))
        sign = 1.0 if match[2] == "<" else -1.0
        *weights, constant = (sign * (a - b) for a, b in zip(left, right, strict=True))
        if sum(a != 0.0 for a in weights) < 2:
            raise ConfigError(
                f"constraint = {text!r}: {part.strip()} is not between two knobs: theta_min and "
                "theta_max limit one"
            )
        lines.append(Line(part.strip(), tuple(weights), 0.0 - constant))
    return tuple(lines)


def _is_line(part: str) -> bool:
    return "(" not in part and ("<=" in part or ">=" in part)


def _parse_sum(text: str, names: Sequence[str], whole: str) -> list[float]:
    """Return the weight of each knob in a sum, and its constant."""
    values, at = [0.0] * (len(names) + 1), 0
    known = [*names, *(f"theta[{i}]" for i in range(len(names)))]
    while at < len(text):
        match = _TERM.match(text, at)
        assert match is not None, "each part may be missing"
        sign, number, name = match.groups()
        if not (number or name) or not (sign or at == 0):
            raise ConfigError(f"constraint = {whole!r}: {text[at:].strip()!r} is not a sum of "
                              f"knobs, each with a factor: {FORMS}")  # fmt: skip
        if name and name not in known:
            raise ConfigError(f"constraint = {whole!r}: unknown knob {name!r}: "
                              f"{nearest(name, known)}")  # fmt: skip
        value = float(f"{sign}{number or 1}")
        values[known.index(name) % len(names) if name else -1] += value
        at = match.end()
    if not all(map(math.isfinite, values)):
        raise ConfigError(f"constraint = {whole!r}: a factor is not finite")
    return values


def parse_constraint(text: str) -> Constraint | None:
    """Return the bound on a signal that a constraint names, None without; raise ConfigError.

    >>> parse_constraint("rms(/rig/effort:data, 10 s) < 1.5").bound
    1.5
    """
    parts = [part.strip() for part in text.split(";") if part.strip() and not _is_line(part)]
    if not parts:
        return None
    match = _FORM.fullmatch(parts[0])
    if len(parts) > 1 or match is None or match[1] not in STATISTICS:
        raise ConfigError(f"constraint = {text!r}: {FORMS}")
    try:
        window, bound = float(match[3]), float(match[4])
    except ValueError:
        window = bound = math.nan
    if not (0.0 < window < math.inf and 0.0 < bound < math.inf):
        raise ConfigError(f"constraint = {text!r}: window and bound must be numbers above 0")
    source = parse_source(match[2])
    if len(source.fields) != 1:
        raise ConfigError(f"constraint = {text!r}: bounds one field")
    return Constraint(match[1], source, window, bound)
