"""Raw subscriptions of the recorder, fetched by polling.

An executor wakes up for every single message. A recorder has no hurry: it lets messages gather in
the subscription's queue and takes them all every few milliseconds, at less than half the cost.
The time of reception comes from DDS and does not depend on when a message is fetched.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from operator import itemgetter
from typing import Any

from lifecycle_msgs.msg import TransitionEvent
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from koop_bag.bag.losses import LOSSES, LossCounter
from koop_bag.bag.metadata import OfferedQos
from koop_bag.cdr.header import has_step, step_of
from koop_bag.cdr.schema import MessageSchema, load_schema
from koop_bag.mcap.chunk import Row
from koop_node.node.managed import message_type
from koop_node.node.rclpy_internals import publishers_as_told

_AT_ONCE = 2000
"""Messages taken from one topic before the next one has its turn."""


_NO_LIMIT = 9223372036  # [s] DDS's 'no limit'


class RecordedTopic:
    """One topic being recorded.

    Parameters
    ----------
    node : rclpy.node.Node
        Owner of the subscription; its executor must not get to see it.
    name, type_name : str
        Full name and type of the topic.
    queue : int
        Messages that may wait.
    announce : callable
        Gives the topic a channel of the bag when its first message has come. Not before: only then
        it is known which QoS its publishers offer.
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
        self._announce = announce
        self._node = node
        self._type = message_type(self.schema.name)
        self._queue = queue
        self._heard = 0.0  # steady clock, of the last message [s]
        self._told: list[dict[str, Any]] = []  # of the publishers
        self._wanted = (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
        self.subscription = self._subscribe()

    def take(self, taken: list[Taken]) -> None:
        """Append the messages that wait."""
        before = len(taken)
        _take(self, self._type, taken)
        if len(taken) > before:
            self._heard = time.monotonic()

    def silence(self) -> str:
        """Return what to say of a stream that has a publisher and is not heard any more, or ''."""
        if self.losses is None or self.losses.interrupted:
            return ""
        silent = time.monotonic() - self._heard
        if silent < LOSSES.silence or not self._node.count_publishers(self.name):
            return ""
        return f"nothing heard from {self.name} for {silent:.0f} s although it has a publisher"

    def skip(self) -> None:
        """Forget the messages that wait; the steps skipped are not lost."""
        skipped: list[Taken] = []
        self.take(skipped)
        if skipped and self.losses is not None:
            self.losses.interrupt()

    def open_channel(self) -> int:
        """Announce the topic in the bag."""
        self.match()
        self.channel = self._announce(self)
        return self.channel

    def match(self) -> None:
        """Follow the QoS that the publishers offer, so that none of them is incompatible."""
        told = publishers_as_told(self._node, self.subscription.topic_name)
        if told == self._told:
            return
        self._told = told
        infos = self._node.get_publishers_info_by_topic(self.name)
        if not infos:
            return
        self.publishers |= {f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in infos}
        profiles = [info.qos_profile for info in infos]
        self.offered = tuple(dict.fromkeys(offered_qos(profile) for profile in profiles))
        reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
        kept = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        wanted = (
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        )
        if wanted != self._wanted:
            self._wanted = wanted
            self._node.destroy_subscription(self.subscription)
            self.subscription = self._subscribe()

    def _subscribe(self) -> Any:
        return subscribe(self._node, self._type, self.name, self._queue, *self._wanted)


class WatchedNode:
    """Lifecycle transitions of a node that publishes recorded topics.

    While it is inactive, no message of it is lost.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self.subscription: Any = node.create_subscription(
            TransitionEvent, f"{name}/transition_event", polled, QoSProfile(depth=100), raw=True
        )

    def take(self, taken: list[Taken]) -> None:
        """Append the transitions that wait."""
        _take(self, TransitionEvent, taken)


Taken = tuple[int, RecordedTopic | WatchedNode, int, bytes]
"""Receive time [ns], topic or node, send time [ns], serialized message."""


def _take(source: RecordedTopic | WatchedNode, kind: Any, taken: list[Taken]) -> None:
    for received, sent, data in waiting(source.subscription, kind):
        taken.append((received, source, sent, data))


def subscribe(
    node: Node,
    kind: Any,
    name: str,
    depth: int,
    reliability: ReliabilityPolicy,
    durability: DurabilityPolicy,
) -> Any:
    """Return a raw subscription that is polled; the node's executor must not get to see it."""
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability
    )
    events = SubscriptionEventCallbacks(use_default_callbacks=False)
    return node.create_subscription(kind, name, polled, profile, raw=True, event_callbacks=events)


def waiting(subscription: Any, kind: Any) -> Iterator[tuple[int, int, bytes]]:
    """Take the messages that wait: when received and sent [ns], and the serialized message.

    One that was lost and sent again is received after those that waited for it: so are they.
    """
    take, received = subscription.handle.take_message, 0
    for _ in range(_AT_ONCE):
        item = take(kind, True)
        if item is None:
            return
        data, info = item
        # not every DDS gives the time of reception
        received = max(received, info["received_timestamp"] or time.time_ns())
        yield received, info["source_timestamp"], data


def fetch(topics: Collection[RecordedTopic], nodes: Iterable[WatchedNode] = ()) -> list[Row]:
    """Take the waiting messages of all topics, in the order of reception, and count them.

    A transition of a node interrupts the count of the topics that it publishes.
    """
    taken: list[Taken] = []
    sources: list[RecordedTopic | WatchedNode] = [*topics, *nodes]
    for source in sources:
        source.take(taken)
    taken.sort(key=itemgetter(0))
    rows: list[Row] = []
    for received, topic, sent, data in taken:
        if isinstance(topic, WatchedNode):
            for each in topics:
                if each.losses is not None and topic.name in each.publishers:
                    each.losses.interrupt()
            continue
        topic.count += 1
        if topic.losses is not None:
            with suppress(struct.error):  # a damaged message is recorded, too
                topic.losses.add(step_of(data))
        rows.append((received, topic.channel or topic.open_channel(), sent, data))
    return rows


def offered_qos(profile: QoSProfile) -> OfferedQos:
    """Return a publisher's QoS in the bag's terms."""

    def word(policy: Any) -> str:
        return str(policy.name).lower()

    def span(duration: Duration) -> tuple[int, int] | None:
        seconds, nanoseconds = divmod(duration.nanoseconds, 1_000_000_000)
        limited = duration.nanoseconds > 0 and seconds < _NO_LIMIT
        return (seconds, nanoseconds) if limited else None

    return OfferedQos(
        reliability=word(profile.reliability),
        durability=word(profile.durability),
        # discovery has neither of these two: they are 'unknown' and 0
        history=word(profile.history),
        depth=profile.depth,
        liveliness=word(profile.liveliness),
        deadline=span(profile.deadline),
        lifespan=span(profile.lifespan),
        liveliness_lease_duration=span(profile.liveliness_lease_duration),
    )


def polled(message: bytes) -> None:
    """Stand in for the callback: no executor takes from such a subscription."""
    raise AssertionError("recorded topics are polled, not executed")
