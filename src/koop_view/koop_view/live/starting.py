"""Nodes that still wait for their loop. Pure.

A node of a loop begins once as many listen to its topic as the loop has: a viewer that listens by
then is taken for one of them, and the first samples are lost to the recorder. So a node's topics
are listened to only when it has said that it works; those of one that never reports, as a rig or
the commander of a commissioning, when it has been there for a while.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

SILENCE = 3.0  # [s] without a report, of which there is one a second: the node is gone
STRANGER = 5.0  # [s] after which a node that never reports is taken to have begun


@dataclass
class _NodeRecord:
    since: float
    heard: float | None = None
    works: bool = False


class Starting:
    """The nodes of a domain and whether each has begun to work."""

    def __init__(self) -> None:
        self._nodes: dict[str, _NodeRecord] = {}

    def update(self, nodes: Iterable[str], now: float) -> None:
        """Take in the nodes that there are."""
        self._nodes = {name: self._nodes.get(name, _NodeRecord(now)) for name in nodes}

    def hear(self, node: str, works: bool, active: bool, now: float) -> bool:
        """Take in a node's report; return whether it has begun to work, perhaps once more."""
        record = self._nodes.setdefault(node, _NodeRecord(now))
        fresh = record.heard is not None and now - record.heard < SILENCE
        before = record.works and fresh
        record.heard = now
        record.works = active and (works or before)  # a loop that pauses goes on
        return record.works and not before

    def waits(self, node: str, now: float) -> bool:
        """Return whether a node may still be waiting for those that listen to it."""
        record = self._nodes.get(node)
        if record is None:
            return False
        if record.heard is None:
            return now - record.since < STRANGER
        return not record.works or now - record.heard > SILENCE
