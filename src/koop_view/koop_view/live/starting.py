"""Which nodes still wait for their loop. Pure.

A node of a loop begins once as many listen to its topic as the loop has: a viewer that listens by
then is taken for one of them, and the first samples are lost to the recorder. So a node's topics
are listened to only when it has said that it works; those of one that never reports, as a rig or
the commander of a commissioning, when it has been there for a while.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

SILENCE = 3.0  # [s] without a report, of which there is one a second: the node is gone
STRANGER = 5.0  # [s] after which a node that never reports has begun


@dataclass
class _Known:
    since: float
    heard: float | None = None
    works: bool = False


class Starting:
    """Keeps what the nodes said."""

    def __init__(self) -> None:
        self._nodes: dict[str, _Known] = {}

    def see(self, nodes: Iterable[str], now: float) -> None:
        """Take in which nodes there are."""
        self._nodes = {name: self._nodes.get(name, _Known(now)) for name in nodes}

    def hear(self, node: str, works: bool, active: bool, now: float) -> bool:
        """Take in a node's report; return whether it has begun to work, perhaps once more."""
        known = self._nodes.setdefault(node, _Known(now))
        fresh = known.heard is not None and now - known.heard < SILENCE
        before = known.works and fresh
        known.heard = now
        known.works = active and (works or before)  # a loop that pauses goes on
        return known.works and not before

    def waits(self, node: str, now: float) -> bool:
        """Return whether a node may still be waiting for those that listen to it."""
        known = self._nodes.get(node)
        if known is None:
            return False
        if known.heard is None:
            return now - known.since < STRANGER
        return not known.works or now - known.heard > SILENCE
