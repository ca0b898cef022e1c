"""Raw subscriptions of the recorder, fetched by polling.

An executor wakes up for every single message. A recorder has no hurry: it lets messages gather in
the subscription's queue and takes them all every few milliseconds, at less than half the cost.
The time of reception comes from DDS and does not depend on when a message is fetched.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from lifecycle_msgs.msg import TransitionEvent
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from koop_bag.bag.losses import LOSSES, LossCounter
from koop_bag.bag.metadata import POLICIES, SPANS, OfferedQos
from koop_bag.cdr.definition import has_step
from koop_bag.cdr.schema import MessageSchema, load_schema
from koop_bag.mcap.chunk import CHANNEL, LOG_TIME, Batch
from koop_bag.recorder.drain import NO_IDS, NONE, Drain, Rows, count_steps
from koop_node.node.graph import UNKNOWN
from koop_node.node.managed import message_type
from koop_node.node.rclpy_internals import polled, publishers_as_told

_NO_LIMIT = 9223372036  # [s] DDS's 'no limit'


class RecordedTopic:
    """One topic being recorded, of a full name and a type; ``queue`` messages may wait.

    ``announce`` gives the topic a channel of the bag when its first message has come. Not before:
    only then it is known which QoS its publishers offer.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        type_name: str,
        queue: int,
        announce: Callable[[RecordedTopic], int],
    ) -> None:
        self.name = name
        self.schema: MessageSchema = load_schema(type_name)
        self.channel = 0
        """The bag's channel; 0 until it is announced."""
        self.count = 0
        self.offered: tuple[OfferedQos, ...] = ()
        """QoS of the publishers that have been there."""
        self.publishers: set[str] = set()
        """Full names of their nodes."""
        self.losses = LossCounter() if has_step(self.schema.name, self.schema.text) else None
        self.foreign = ""
        """What to say of publishers of another type."""
        self._announce = announce
        self._node = node
        self._type = message_type(self.schema.name)
        self._queue = queue
        self._heard = 0.0  # steady clock, of the last message [s]
        self._told: list[dict[str, Any]] = []  # of the publishers
        self._wanted = (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
        self.subscription: Any = self._subscribe()
        """None as long as all that is published is in the journal."""
        self.number = -1
        """Of the topic in the journal; -1: it is not there."""
        self.own = NO_IDS
        """Publishers whose messages are in the journal."""
        self._writer = ""

    def count_rows(self, rows: Rows, transitions: Iterable[Transition] = ()) -> None:
        """Count messages that were taken, and what was lost.

        A transition of a node that publishes the topic interrupts.
        """
        if len(rows):
            self._heard = time.monotonic()
            self.count += len(rows)
        if self.losses is None:
            return
        for at, name in transitions:
            if name in self.publishers:
                end = int(np.searchsorted(rows[:, LOG_TIME], at, "right"))
                count_steps(rows[:end], self.losses)
                rows = rows[end:]
                self.losses.interrupt()
        count_steps(rows, self.losses)

    def silence(self) -> str:
        """Return what to say of a stream that has a publisher and is not heard any more, or ''."""
        if self.losses is None or self.losses.interrupted:
            return ""
        silent = time.monotonic() - self._heard
        if silent < LOSSES.silence or not self._node.count_publishers(self.name):
            return ""
        return f"nothing heard from {self.name} for {silent:.0f} s although it has a publisher"

    def skip_rows(self, rows: Rows) -> None:
        """Take note that messages were taken and forgotten; their steps are not lost."""
        if len(rows):
            self._heard = time.monotonic()
            if self.losses is not None:
                self.losses.interrupt()

    def announce(self) -> None:
        """Give the topic a channel of the bag, at its first message."""
        if not self.channel:
            self.match()
            self.channel = self._announce(self)

    @property
    def sources(self) -> list[Any]:
        """What :meth:`koop_bag.recorder.drain.Drain.take` takes from."""
        return [source for source in (self.subscription, self.number) if source not in (None, -1)]

    def follow(self, number: int, writer: str) -> None:
        """Take what a node writes into the journal, in place of what it sends."""
        self.number, self._writer = number, writer
        self._unsubscribe()
        self._told = []

    def _unsubscribe(self) -> None:
        if self.subscription is not None:
            self._node.destroy_subscription(self.subscription)
        self.subscription = None

    def match(self) -> None:
        """Follow the QoS that the publishers offer, so that none of them is incompatible."""
        told = publishers_as_told(self._node, self.name)
        if told == self._told:
            return
        self._told = told
        every, kind = self._node.get_publishers_info_by_topic(self.name), self.schema.name
        infos = [info for info in every if info.topic_type == kind]
        self.foreign = ""
        if others := " and ".join(sorted({info.topic_type for info in every} - {kind})):
            self.foreign = f"{self.name} is published as {others}: only {kind} is recorded"
        if not infos:
            return
        names = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        self.publishers |= set(names)
        profiles = [info.qos_profile for info in infos]
        self.offered = tuple(dict.fromkeys(offered_qos(profile) for profile in profiles))
        reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
        kept = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        wanted = (
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        )
        # a name that is still on its way is the writer's, until it is known to be another's
        own = [n == self._writer or n.endswith(UNKNOWN) for n in names if self.number >= 0]
        ids = (bytes(info.endpoint_gid) for info, is_own in zip(infos, own, strict=False) if is_own)
        self.own = np.frombuffer(b"".join(ids), np.int64).reshape(-1, 2)
        heard = self.subscription is not None
        if (heard and wanted != self._wanted) or (not heard and not all(own)):
            self._unsubscribe()
            self._wanted = wanted
            self.subscription = self._subscribe()

    def _subscribe(self) -> Any:
        return subscribe(self._node, self._type, self.name, self._queue, *self._wanted)


def watch(node: Node, name: str) -> Any:
    """Subscribe to the lifecycle transitions of a node that publishes recorded topics.

    While it is inactive, no message of it is lost.
    """
    topic = f"{name}/transition_event"
    return node.create_subscription(TransitionEvent, topic, polled, QoSProfile(depth=100), raw=True)


Transition = tuple[int, str]
"""Time of its reception [ns] and name of the node."""


def subscribe(
    node: Node,
    kind: Any,
    name: str,
    depth: int,
    reliability: ReliabilityPolicy,
    durability: DurabilityPolicy,
) -> Any:
    """Return a raw subscription that is polled, and that an executor of the node does not see."""
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability
    )
    events = SubscriptionEventCallbacks(use_default_callbacks=False)
    return node.create_subscription(kind, name, polled, profile, raw=True, event_callbacks=events)


def fetch(drain: Drain, topics: Sequence[RecordedTopic], nodes: Mapping[str, Any]) -> Batch:
    """Take the waiting messages of all topics, in the order of reception, and count them.

    A transition of one of the nodes, by name with what :func:`watch` returned, interrupts the count
    of the topics that it publishes.
    """
    taken = take(drain, topics, nodes)
    transitions = sorted(
        (at, name)
        for name, rows in zip(nodes, taken[len(topics) :], strict=True)
        for at in rows[:, LOG_TIME].tolist()
    )
    for topic, rows in zip(topics, taken, strict=False):
        topic.count_rows(rows, transitions)
    table = np.concatenate([NONE, *taken[: len(topics)]])
    table = table[np.argsort(table[:, LOG_TIME], kind="stable")]
    for number in dict.fromkeys(table[:, CHANNEL].tolist()):
        topics[number].announce()
    channels = np.array([topic.channel for topic in topics], np.int64)
    table[:, CHANNEL] = channels[table[:, CHANNEL]]
    return Batch(table, drain.data)


def skip(drain: Drain, topics: Sequence[RecordedTopic], nodes: Mapping[str, Any]) -> None:
    """Take the waiting messages and forget them."""
    for topic, rows in zip(topics, take(drain, topics, nodes), strict=False):
        topic.skip_rows(rows)


def take(drain: Drain, topics: Sequence[RecordedTopic], nodes: Mapping[str, Any]) -> list[Rows]:
    """Take the waiting messages, each with the number of its topic for a channel."""
    sources = [(n, source) for n, topic in enumerate(topics) for source in topic.sources]
    own = np.concatenate([NO_IDS, *(topic.own for topic in topics)])
    taken = drain.take([*(source for _, source in sources), *nodes.values()], own)
    parts: list[list[Rows]] = [[] for _ in topics]
    for (n, _), rows in zip(sources, taken, strict=False):
        parts[n].append(rows)
    return [*(_together(n, some) for n, some in enumerate(parts)), *taken[len(sources) :]]


def _together(channel: int, parts: Sequence[Rows]) -> Rows:
    """Return the messages of a topic from all of its sources, in order."""
    for part in parts:
        part[:, CHANNEL] = channel
    if len(parts) == 1:
        return parts[0]
    rows: Rows = np.concatenate([NONE, *parts])
    return rows[np.argsort(rows[:, LOG_TIME], kind="stable")]


def offered_qos(profile: QoSProfile) -> OfferedQos:
    """Return a publisher's QoS in the bag's terms."""

    def span(duration: Duration) -> tuple[int, int] | None:
        seconds, nanoseconds = divmod(duration.nanoseconds, 1_000_000_000)
        limited = duration.nanoseconds > 0 and seconds < _NO_LIMIT
        return (seconds, nanoseconds) if limited else None

    # discovery has neither history nor depth: they are 'unknown' and 0
    policies = {name: getattr(profile, name).name.lower() for name in POLICIES}
    policies |= {name: span(getattr(profile, name)) for name in SPANS}
    return OfferedQos(depth=profile.depth, **policies)
