"""A bound on a second signal, as rig files and parameters write it. Pure: no ROS.

constraint = statistic "(" topic ":" field "," window ["s"] ")" "<" bound
statistic  = "rms" | "peak"                      rms(/rig/effort:data, 10 s) < 1.5
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from koop_core.config.fields import Source, parse_source
from koop_core.config.parameter import ConfigError

STATISTICS = ("rms", "peak")
_FORM = re.compile(r"(\w+)\s*\(\s*([^,]+?)\s*,\s*(\S+?)\s*s?\s*\)\s*<\s*(\S+)", re.ASCII)


class Constraint(NamedTuple):
    """A statistic of a signal that must stay below a bound.

    Attributes
    ----------
    statistic : str
        ``rms``, the root mean square, or ``peak``, the largest magnitude.
    source : Source
        Topic and field of the signal.
    window : float
        Time over which the statistic is taken [s], of the rig's own time.
    bound : float
        What it must stay below, in the signal's unit; above 0.
    """

    statistic: str
    source: Source
    window: float
    bound: float


def parse_constraint(text: str) -> Constraint | None:
    """Return the constraint that a text names, None for an empty one; raise ConfigError.

    >>> parse_constraint("rms(/rig/effort:data, 10 s) < 1.5").bound
    1.5
    """
    if not text.strip():
        return None
    match = _FORM.fullmatch(text.strip())
    if match is None or match[1] not in STATISTICS:
        raise ConfigError(
            f"constraint = {text!r}: write rms(/topic:field, 10 s) < 1.5, or peak in place of rms"
        )
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
