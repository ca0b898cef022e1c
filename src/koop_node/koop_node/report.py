"""What a node says on /diagnostics, before it is a message. Pure: imports nothing of ROS."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # as in diagnostic_msgs/DiagnosticStatus
_URGENCY = (OK, WARN, STALE, ERROR)  # a broken input asks for more than a silent one


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
