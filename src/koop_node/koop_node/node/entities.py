"""Publishers, subscriptions, timers and services that are made together and end together."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import cached_property, partial
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer as RosTimer

from koop_core.errors import KoopError
from koop_core.journal import NOWHERE, Journal, Topic, append, journal_of_process
from koop_core.kernels import direct
from koop_core.port import Port
from koop_node.node import schedule
from koop_node.node.graph import Listeners, message_type_of, publishers_of, type_name
from koop_node.node.memory import Memory
from koop_node.node.rclpy_internals import announce_parameters, parameters_are_heard
from koop_node.node.schedule import Timer
from koop_node.node.wire import WireError, codec

PATIENCE = 0.5  # [s] that the last messages may take to arrive
LOOK_PERIOD = 0.05  # [s] between looks for subscribers

_TWO = inspect.signature(lambda message, info: None)


class Writer:
    """Publishes messages of one type without rclpy's conversion."""

    def __init__(
        self, node: Node, publisher: Publisher, kind: Any, journal: Journal | None
    ) -> None:
        self.publisher = publisher
        self._codec = codec(kind)
        self._encode = self._codec.encode
        self._send = publisher.handle.publish_raw  # its publish() guards against other threads
        self._journal = journal
        self._place = NOWHERE
        if journal is not None:
            name, node_name = publisher.topic_name, node.get_fully_qualified_name()
            self._place = journal.place(Topic(name, type_name(kind), node_name))
            self._append = direct(append, NOWHERE, 0, 0)

    def publish(self, message: Any) -> None:
        """Publish a message, of the codec or of the message class."""
        data = self._encode(message)
        self._send(data)
        if self._journal is not None:
            self._append(self._place, np.frombuffer(data, np.uint8).ctypes.data, len(data))

    def acknowledged(self, patience: float) -> bool:
        """Return whether all readers have what was sent, or have within a time [s] each."""
        heard = self.publisher.wait_for_all_acked(Duration(seconds=patience))
        return heard and (self._journal is None or self._journal.read_within(patience))

    def port(self, message: Any, names: Sequence[str]) -> Port:
        """Return what compiled code publishes through; a message says what it does not write."""
        data = self._encode(message)
        self._memory.write(data)
        return self._memory.port(self.publisher, self._codec.places(data), names, self._place)

    def last(self) -> Any:
        """Return the last message that compiled code has published."""
        return self._codec.decode(self._memory.read())

    @cached_property
    def _memory(self) -> Memory:
        return Memory()


def _matching(qos: QoSProfile, publishers: Sequence[Any]) -> QoSProfile | None:
    """Return a best-effort profile if one of the publishers could not be heard by a reliable one.

    A reliable subscription makes such a publisher's process log a warning.
    """
    best_effort = ReliabilityPolicy.BEST_EFFORT
    offered = [publisher.qos_profile.reliability for publisher in publishers]
    if qos.reliability == best_effort or best_effort not in offered:
        return None
    return QoSProfile(depth=qos.depth, reliability=best_effort)


class Input:
    """A subscription that hears reliable publishers and best-effort ones.

    It is reliable, so that nothing is lost in lockstep or on a busy machine, until a publisher is
    there that offers best effort only, as most drivers of sensors do.
    """

    def __init__(
        self, node: Node, kind: Any, topic: str, deliver: Any, qos: QoSProfile, raw: bool
    ) -> None:
        self._node, self._kind, self._deliver = node, kind, deliver
        self._make = partial(node.create_subscription, kind, topic, deliver, raw=raw)
        self.number = 0
        """Of the newest message, as its publisher counts them; 0 where DDS does not give it."""
        heard = publishers_of(node, node.resolve_topic_name(topic))
        self.subscription: Subscription = self._make(_matching(qos, heard) or qos)

    def match(self, publishers: Sequence[Any]) -> None:
        """Become best effort if one of the publishers could not be heard otherwise."""
        if other := _matching(self.subscription.qos_profile, publishers):
            self.close()
            self.subscription = self._make(other)

    def port(self, message: Any, names: Sequence[str]) -> Port:
        """Return what compiled code takes messages from that are laid out as ``message``."""
        own = codec(self._kind)
        return self._memory.port(self.subscription, own.places(own.encode(message)), names)

    def last(self) -> Any:
        """Return the last message that compiled code has taken."""
        return codec(self._kind).decode(self._memory.read())

    def deliver_last(self) -> None:
        """Call back with a message that compiled code has taken and cannot read."""
        self._deliver(self._memory.read(), {"source_timestamp": int(self._memory.info[0])})

    @cached_property
    def _memory(self) -> Memory:
        return Memory()

    def close(self) -> None:
        """Hear no more."""
        self._node.destroy_subscription(self.subscription)


class _OfRos:
    """A timer of ROS, for nodes that another program spins."""

    def __init__(self, timer: RosTimer) -> None:
        self._timer = timer
        self.cancel = timer.cancel

    def restart(self, period: float | None = None, due: float | None = None) -> None:
        if period is not None:
            self._timer.timer_period_ns = round(period * 1e9)
        self._timer.reset()


class Entities:
    """Entities of one state of a node's life: made on the way in, destroyed on the way out.

    Callbacks are called only until then: an executor may still hold messages that came before.
    Timers run on the steady clock, whatever simulated time does.
    """

    def __init__(self, node: Node, prepare: Callable[[], object]) -> None:
        self.inputs: dict[str, Input] = {}
        """Made by :meth:`reader` and :meth:`dated_subscription`, by topic as written."""
        self.waiting_for = ""
        self.fail: Callable[[], object] = bool
        """Ends the node as one that failed."""
        self._node = node
        self._prepare = prepare  # before a timer calls back; the executor does it for all else
        self._stack = ExitStack()
        self._publishers: list[Publisher] = []
        self._open = True
        self._schedule = schedule.current()
        self._journal = journal_of_process()

    def publisher(self, kind: Any, topic: str, qos: QoSProfile) -> Publisher:
        """Create a publisher."""
        made = self._node.create_publisher(kind, topic, qos)
        self._publishers.append(made)
        self._stack.callback(self._node.destroy_publisher, made)
        return made

    def writer(self, kind: Any, topic: str, qos: QoSProfile) -> Writer:
        """Create a publisher of messages that are encoded here; see :mod:`koop_node.node.wire`."""
        return Writer(self._node, self.publisher(kind, topic, qos), kind, self._journal)

    def reader(
        self, kind: Any, topic: str, callback: Callable[[Any, float], None], qos: QoSProfile
    ) -> Input:
        """Listen as :meth:`dated_subscription` does, to messages that are decoded here.

        One that cannot be is reported and goes no further. See :mod:`koop_node.node.wire`.
        """
        decode, logger = codec(kind).decode, self._node.get_logger()

        def take(data: bytes, written: float) -> None:
            try:
                message = decode(data)
            except WireError as error:
                logger.error(f"'{topic}': {error}", throttle_duration_sec=60.0)
                return
            callback(message, written)

        return self._input(kind, topic, take, qos, True)

    def subscription(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> Subscription:
        """Create a subscription."""

        def deliver(message: Any) -> None:
            if self._open:
                callback(message)

        made = self._node.create_subscription(kind, topic, deliver, qos)
        self._stack.callback(self._node.destroy_subscription, made)
        return made

    def dated_subscription(
        self, kind: Any, topic: str, callback: Callable[[Any, float], None], qos: QoSProfile
    ) -> Input:
        """Listen to messages with a callback that also gets when a message was written.

        That is a time on the clock of the writer's host [s], which every DDS sends along.
        """
        return self._input(kind, topic, callback, qos, False)

    def _input(
        self,
        kind: Any,
        topic: str,
        callback: Callable[[Any, float], None],
        qos: QoSProfile,
        raw: bool,
    ) -> Input:
        def deliver(*arguments: Any) -> None:
            # the EventsExecutor of rclpy 7.1 gives message and info as one tuple
            message, info = arguments if len(arguments) == 2 else arguments[0]
            if self._open:
                made.number = info.get("publication_sequence_number") or 0
                callback(message, info["source_timestamp"] * 1e-9)

        deliver.__signature__ = _TWO  # type: ignore[attr-defined]  # what rclpy goes by
        made = self.inputs[topic] = Input(self._node, kind, topic, deliver, qos, raw)
        self._stack.callback(made.close)
        return made

    def service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> Service:
        """Create a service."""
        made = self._node.create_service(kind, name, callback)
        self._stack.callback(self._node.destroy_service, made)
        return made

    def timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Create a timer [s]: of the schedule of the process, or of ROS where there is none."""

        def tick() -> None:
            if self._open:
                self._prepare()
                callback()

        if self._schedule is not None:
            scheduled = self._schedule.timer(period, tick)
            self._stack.callback(scheduled.cancel)
            return scheduled
        made = self._node.create_timer(period, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._stack.callback(self._node.destroy_timer, made)
        return _OfRos(made)

    def when_heard(self, needed: Mapping[Publisher, Listeners], then: Callable[[], object]) -> None:
        """Call ``then`` once every publisher has its listeners.

        A reliable writer delivers everything that it wrote after it matched a reader; a node that
        creates its subscription only then tells those upstream that all downstream is ready, and
        no first sample is lost. Before it, the parameters of the node are announced: the answer to
        a listener that asks for them may come after the end of a short run.
        """
        waited = 0

        def look() -> None:
            nonlocal waited
            readers = self._journal.readers() if self._journal is not None else {}
            missing = {
                p.topic_name: nodes.missing(self._node, p, readers.get(p.topic_name, ""))
                for p, nodes in needed.items()
            }
            text = "; ".join(f"{names} to listen to {t}" for t, names in missing.items() if names)
            if not text and readers and not parameters_are_heard(self._node):
                text = f"{next(iter(readers.values()))} to listen to parameters"  # not yet by DDS
            self.waiting_for = text and f"waiting for {text}"
            if not text:
                timer.cancel()
                announce_parameters(self._node)
                then()
            elif waited % 100 == 20:
                self._node.get_logger().info(self.waiting_for)
            waited += 1

        timer = self.timer(LOOK_PERIOD, look)

    def when_typed(
        self,
        endpoints: Callable[[Node, str], list[Any]],
        topic: str,
        then: Callable[[str], object],
    ) -> None:
        """Call ``then`` with the message type of a topic once it has an endpoint.

        That is one of ``publishers_of`` or ``subscribers_of``, of :mod:`koop_node.node.graph`.
        """
        self.waiting_for = f"waiting for {endpoints.__name__.replace('_', ' ')} {topic}"
        self._node.get_logger().info(self.waiting_for)

        def look() -> None:
            if not (infos := endpoints(self._node, topic)):
                return
            timer.cancel()
            self.waiting_for = ""
            try:
                then(message_type_of(topic, infos))
            except KoopError as error:
                self._node.get_logger().error(str(error))
                self.fail()

        timer = self.timer(LOOK_PERIOD, look)

    def on_close(self, action: Callable[[], object]) -> None:
        """Call ``action`` when this ends, before what was made earlier is destroyed."""
        self._stack.callback(action)

    def close(self) -> None:
        """Destroy everything; what was published is waited for, for it may still be on its way."""
        self._open = False
        deadline = time.monotonic() + PATIENCE
        for publisher in self._publishers:
            left = deadline - time.monotonic()
            if left > 0.0 and publisher.get_subscription_count():
                publisher.wait_for_all_acked(Duration(seconds=left))
        self._stack.close()
