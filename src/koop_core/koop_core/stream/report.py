"""What a node says on /diagnostics, before it is a message. Pure: imports nothing of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # as in diagnostic_msgs/DiagnosticStatus
_URGENCY = (OK, WARN, STALE, ERROR)  # a broken input asks for more than a silent one

SETTLED = 5.0  # [s] that a lower level must last before it is news


class Finding(NamedTuple):
    """One thing that a node found, with its level."""

    level: int
    text: str


def summary(findings: Iterable[Finding]) -> Finding:
    """Return the most urgent level, and all texts that are not OK with the most urgent first.

    Where all is OK, the texts are those of the OK findings.
    """
    ordered = sorted(findings, key=lambda item: -_URGENCY.index(item.level))
    if not ordered:
        return Finding(OK, "")
    level = ordered[0].level
    told = [item for item in ordered if item.level != OK] if level != OK else ordered
    return Finding(level, "; ".join(item.text for item in told if item.text))


class News:
    """Which findings are worth a line of the log: whoever reads only the log learns them too.

    A more urgent level is news at once, a less urgent one when it has lasted: what comes and goes
    is one line, not two every second.
    """

    def __init__(self) -> None:
        self._told = OK
        self._lower_since = math.nan

    def of(self, found: Finding, now: float) -> Finding | None:
        """Return what to log.

        Parameters
        ----------
        found : Finding
            The summary of this moment.
        now : float
            Steady time [s].
        """
        change = _URGENCY.index(found.level) - _URGENCY.index(self._told)
        if change >= 0:
            self._lower_since = math.nan
        elif math.isnan(self._lower_since):
            self._lower_since = now
        if change > 0 or now - self._lower_since >= SETTLED:
            self._told, self._lower_since = found.level, math.nan
            return found
        return None
