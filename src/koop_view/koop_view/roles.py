"""Which nodes and topics make a loop. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, replace

from koop_view.source import Loop

GONE = 1.0  # [s] without any of its nodes: the loop has ended, before the page misses their reports
STATE, COST, THETA = (f"koop_msgs/msg/{name}" for name in ("MeasuredState", "Cost", "ControlInput"))


def namespace_of(name: str) -> str:
    """Return the namespace of a full name.

    >>> namespace_of("/rig/theta"), namespace_of("/theta")
    ('/rig', '/')
    """
    return name.rpartition("/")[0] or "/"


def loops(
    published: Mapping[str, Mapping[str, str]],
    nameless: Mapping[str, str],
    managed: Collection[str] = (),
) -> dict[str, Loop]:
    """Return the loops, by namespace.

    A lifter publishes a cost, a controller a control input; the plant is the node that publishes
    the state and is neither, for a lifter that reads a rig's own message publishes the state.
    Where a commander passes on what a controller says, the controller is the one that is managed,
    and theta is what the rig gets.

    Parameters
    ----------
    published : mapping of str to mapping
        Topics with their types, by full name of the node.
    nameless : mapping of str to str
        Topics with their types that are published by what is no ROS node, as some rigs are.
    managed : collection of str
        Nodes with a lifecycle.
    """
    found: dict[str, Loop] = {}
    for node, topics in sorted(published.items(), key=lambda item: (item[0] in managed, item[0])):
        of_type = {kind: topic for topic, kind in sorted(topics.items(), key=_last_is_own)}
        own = {"state": of_type.get(STATE), "cost": of_type.get(COST), "theta": of_type.get(THETA)}
        if not any(own.values()):
            continue
        role = "lifter" if own["cost"] else "controller" if own["theta"] else "plant"
        space = namespace_of(node)
        loop = found.get(space, Loop(space))
        given = {name: topic for name, topic in own.items() if topic}
        if loop.theta == f"{space.rstrip('/')}/theta":
            given.pop("theta", None)
        found[space] = replace(loop, **{role: node}, **given)
    for topic, kind in sorted(nameless.items(), key=_last_is_own):
        loop = found.get(namespace_of(topic), Loop(namespace_of(topic)))
        if kind == STATE and (loop.state is None or loop.state in nameless):
            found[loop.namespace] = replace(loop, state=topic)
    return found


def _last_is_own(item: tuple[str, str]) -> tuple[bool, str]:
    """Order topics so that the loop's own name comes last: a command may have the same type."""
    return item[0].endswith(("/theta", "/cost", "/state")), item[0]


class Known:
    """The loops of a domain: a dead node keeps its place in its loop until the last one is gone."""

    def __init__(self) -> None:
        self.loops: dict[str, Loop] = {}
        self._seen: dict[str, float] = {}

    def see(self, found: Mapping[str, Loop], now: float) -> bool:
        """Take in the loops that are there; return whether it is news."""
        before = self.loops
        self._seen |= dict.fromkeys(found, now)
        joined = before | {name: _joined(before.get(name), loop) for name, loop in found.items()}
        self.loops = {name: it for name, it in joined.items() if now - self._seen[name] <= GONE}
        self._seen = {name: self._seen[name] for name in self.loops}
        return self.loops != before


def _joined(before: Loop | None, now: Loop) -> Loop:
    """Return a loop with what is known of it from before: a node that died has the same name."""
    known = {} if before is None else asdict(before)
    return Loop(**{**known, **{k: v for k, v in asdict(now).items() if v is not None}})
