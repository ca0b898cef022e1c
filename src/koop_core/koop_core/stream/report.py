"""A node's report on /diagnostics, before it is a message. Pure: imports nothing of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from koop_core.stream.settings import STREAM

LEVELS = ("OK", "WARN", "ERROR", "STALE")  # in the order of diagnostic_msgs/DiagnosticStatus
OK, WARN, ERROR, STALE = range(len(LEVELS))
_URGENCY = (OK, WARN, STALE, ERROR)  # a broken input asks for more than a silent one

GHOST = "one that was killed is listed for up to 20 s"  # by DDS: its lease


class NodeFinding(NamedTuple):
    """One thing that a node found, with its level."""

    level: int
    text: str
    at_once: bool = True
    """Whether the log says so at once; else only when it has lasted, as at every start."""


def summary(findings: Iterable[NodeFinding]) -> NodeFinding:
    """Return the most urgent level, and all texts that are not OK with the most urgent first.

    Where all is OK, the texts are the OK findings' texts.
    """
    ordered = sorted(findings, key=lambda item: -_URGENCY.index(item.level))
    if not ordered:
        return NodeFinding(OK, "")
    level = ordered[0].level
    at_once = any(item.at_once for item in ordered if item.level == level)
    texts = [item.text for item in ordered if item.text and (item.level or not level)]
    return NodeFinding(level, "; ".join(texts), at_once)


class News:
    """Which findings are worth a line of the log: a reader of the log alone learns them too.

    A more urgent level is news at once, or when it has lasted if the finding says so; a less urgent
    one when it has lasted: what comes and goes is one line, not two every second.
    """

    def __init__(self) -> None:
        self._logged = OK
        self._since = math.nan  # when the level changed that was not logged yet [s]

    def of(self, state: NodeFinding, now: float) -> NodeFinding | None:
        """Return what to log of the summary at a steady time [s]."""
        change = _URGENCY.index(state.level) - _URGENCY.index(self._logged)
        if change == 0:
            self._since = math.nan
        elif math.isnan(self._since):
            self._since = now
        if (change > 0 and state.at_once) or now - self._since >= STREAM.settled:
            self._logged, self._since = state.level, math.nan
            return state
        return None
