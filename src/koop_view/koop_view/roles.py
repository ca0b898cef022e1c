"""Finds the loops among the nodes and topics of a domain. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace

GONE = 1.0  # [s] without any of its nodes: the loop has ended, before the page misses their reports
STATE, COST, THETA, GUARD = (
    f"koop_msgs/msg/{name}" for name in ("MeasuredState", "Cost", "ControlInput", "GuardState")
)
KINDS = {STATE: "state", COST: "cost", THETA: "theta"}


@dataclass(frozen=True)
class LoopNames:
    """One loop: full names of its nodes and topics, None where there is none."""

    namespace: str
    plant: str | None = None
    lifter: str | None = None
    controller: str | None = None
    state: str | None = None
    cost: str | None = None
    theta: str | None = None
    guard: str | None = None


def namespace_of(name: str) -> str:
    """Return the namespace of a full name.

    >>> namespace_of("/rig/theta"), namespace_of("/theta")
    ('/rig', '/')
    """
    return name.rpartition("/")[0] or "/"


def find_loops(
    published: Mapping[str, Mapping[str, str]],
    nameless: Mapping[str, str],
    managed: Collection[str] = (),
) -> dict[str, LoopNames]:
    """Return the loops, by namespace.

    A lifter publishes a cost, a controller a control input; the plant is the node that publishes
    the state and is neither, for a lifter that reads a rig's own message publishes the state.
    Where a commander passes on what a controller says, the controller is the one that is managed,
    and theta is what the rig gets; so it is with a guard.

    Parameters
    ----------
    published : mapping of str to mapping
        Topics with their types, by full name of the node.
    nameless : mapping of str to str
        Topics with their types whose publisher is not a ROS node, such as a rig's own program.
    managed : collection of str
        Nodes with a lifecycle.
    """
    result: dict[str, LoopNames] = {}
    for node, topics in sorted(published.items(), key=lambda item: (item[0] in managed, item[0])):
        of_type = {kind: topic for topic, kind in sorted(topics.items(), key=_last_is_own)}
        outputs = {name: of_type[kind] for kind, name in KINDS.items() if kind in of_type}
        is_guard = GUARD in of_type
        if not (outputs or is_guard):
            continue
        is_lifter, is_controller = "cost" in outputs, "theta" in outputs
        role = "lifter" if is_lifter else "controller" if is_controller else "plant"
        role = "guard" if is_guard else role
        space = namespace_of(node)
        loop = result.get(space, LoopNames(space))
        if loop.theta == f"{space.rstrip('/')}/theta":
            outputs.pop("theta", None)
        result[space] = replace(loop, **{role: node}, **outputs)
    for topic, kind in sorted(nameless.items(), key=_last_is_own):
        loop = result.get(namespace_of(topic), LoopNames(namespace_of(topic)))
        name = KINDS.get(kind)
        if name and (getattr(loop, name) is None or getattr(loop, name) in nameless):
            result[loop.namespace] = replace(loop, **{name: topic})
    return result


def _last_is_own(item: tuple[str, str]) -> tuple[bool, str]:
    """Order topics so that the loop's own name comes last: a command may have the same type."""
    return item[0].endswith(("/theta", "/cost", "/state")), item[0]


class KnownLoops:
    """The loops of a domain: a dead node keeps its place until the last node of its loop ends."""

    def __init__(self) -> None:
        self.loops: dict[str, LoopNames] = {}
        self._seen: dict[str, float] = {}

    def update(self, loops: Mapping[str, LoopNames], now: float) -> bool:
        """Take in the loops that there are; return whether any has changed."""
        before = self.loops
        self._seen |= dict.fromkeys(loops, now)
        joined = before | {name: _join(before.get(name), loop) for name, loop in loops.items()}
        self.loops = {name: it for name, it in joined.items() if now - self._seen[name] <= GONE}
        self._seen = {name: self._seen[name] for name in self.loops}
        return self.loops != before


def _join(before: LoopNames | None, now: LoopNames) -> LoopNames:
    """Return a loop with the names that it had before: a node that died has the same name."""
    names = {key: name for key, name in asdict(now).items() if name is not None}
    return replace(before or now, **names)
