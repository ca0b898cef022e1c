"""The loops of a ROS domain, as a source."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy as Durability
from rclpy.qos import ReliabilityPolicy as Reliability
from rclpy.serialization import serialize_message

from koop_bag.bag.topics import COMMON_TOPICS
from koop_bag.cdr.schema import load_schema, load_service
from koop_bag.recorder.parameters import ParameterCollector
from koop_bag.recorder.topics import subscribe
from koop_core.errors import KoopError, one_line
from koop_node.client.client import Client
from koop_node.node.managed import message_type
from koop_node.node.received import read_message, read_value
from koop_view import protocol
from koop_view.config import ViewConfig
from koop_view.live.services import OFFERED, ServiceCaller, describe, unpack
from koop_view.protocol import AdvertisedChannel, AdvertisedService
from koop_view.roles import KnownLoops, find_loops
from koop_view.session import ClientSession, Refused, ViewSource

POLL = 0.02  # [s] between two looks for messages while there are viewers
IDLE = 0.1  # [s] while there are none
LOOK = 0.5  # [s] between looks at the graph
PAUSE = 1.5  # [s] without a report, of which there is one per second
EVENTS = 20  # of the executor at a time
LINE = 200  # bytes of the line beside the loops
WAITING = 200  # messages that DDS keeps between two polls; of more, the oldest are lost
MOST = 1000  # channels: a broken domain may have any number
DIAGNOSTICS, CHANGES = "/diagnostics", "/parameter_events"


class LiveSource(ViewSource):
    """The loops of a ROS domain, heard by a client that is polled here."""

    mode = "live"

    def __init__(self, client: Client, config: ViewConfig) -> None:
        super().__init__()
        self._client, self._config = client, config
        self._node = client.node
        self._caller = ServiceCaller(self._node)
        self._collector = ParameterCollector(self._node, "/")
        self._known = KnownLoops()
        self._reported: dict[str, float] = {}  # when a node's newest report came [s]
        self._types: dict[str, str] = {}  # of the topics and services that were examined
        self._topics: dict[str, tuple[Any, Any]] = {}  # subscription and message class
        self._viewers: dict[str, list[tuple[ClientSession, int]]] = {}
        self._numbers = iter(range(1, 2**32))
        self._listen()

    async def run(self) -> None:
        """Follow the loops until cancelled."""
        due = 0.0
        while True:
            now = time.monotonic()
            if now >= due:
                due = now + LOOK
                self._look(now)
            self._poll(now)
            busy = self._viewers or self._caller.waiting
            await asyncio.sleep(POLL if busy else IDLE)

    # -- messages -----------------------------------------------------------------------------

    def subscribe(self, viewer: ClientSession, wanted: Mapping[int, AdvertisedChannel]) -> None:
        for subscription, channel in wanted.items():
            self._viewers.setdefault(channel.topic, []).append((viewer, subscription))
        self._listen()

    def unsubscribe(
        self, viewer: ClientSession, subscription: int, channel: AdvertisedChannel
    ) -> None:
        viewers = self._viewers[channel.topic]
        viewers.remove((viewer, subscription))
        if not viewers:
            del self._viewers[channel.topic]
        self._listen()

    def _listen(self) -> None:
        """Subscribe to the topics that are viewed, and to no other.

        Topics of a loop are read best effort: no writer keeps or repeats anything for a viewer. Of
        the log, the last lines from before are wanted, too.
        """
        wanted = {DIAGNOSTICS, CHANGES, *self._viewers}
        for name in self._topics.keys() - wanted:
            self._node.destroy_subscription(self._topics.pop(name)[0])
        for name in wanted - self._topics.keys():
            kind = message_type(self._types.get(name) or COMMON_TOPICS[name])
            reliable = Reliability.RELIABLE if name in COMMON_TOPICS else Reliability.BEST_EFFORT
            kept = Durability.TRANSIENT_LOCAL if name == "/rosout" else Durability.VOLATILE
            made = subscribe(self._node, kind, name, WAITING, reliable, kept)
            self._topics[name] = made, kind

    def _poll(self, now: float) -> None:
        for _ in range(EVENTS if self._caller.waiting else 2):
            self._client.spin(0.0)
        for name, topic in list(self._topics.items()):
            taken = list(_waiting(*topic))
            for viewer, subscription in self._viewers.get(name, ()):
                for received, data in taken:
                    viewer.deliver(subscription, received, data)
            if name == DIAGNOSTICS:
                self._hear([data for _, data in taken], now)
            elif name == CHANGES:
                self._take_changes([data for _, data in taken])

    def _hear(self, reports: list[bytes], now: float) -> None:
        """Ask a node that reports after a pause for its parameters: it may be a new process."""
        for data in reports:
            report = read_message(data, DiagnosticArray)
            for status in report.status if report is not None else ():
                if now - self._reported.get(status.name, now) > PAUSE:
                    self._collector.values.pop(status.name, None)
                self._reported[status.name] = now

    # -- the graph ----------------------------------------------------------------------------

    def _look(self, now: float) -> None:
        published, served = self._ask_nodes()
        topics = {
            topic: types[0]
            for topic, types in self._node.get_topic_names_and_types()
            if self._node.count_publishers(topic)
        }
        self._take_parameters(served)
        self._take_channels(topics)
        named = {topic for outputs in published.values() for topic in outputs}
        nameless = {topic: kind for topic, kind in topics.items() if topic not in named}
        managed = {node for node, names in served.items() if f"{node}/change_state" in names}
        loops = find_loops(published, nameless, managed)
        about = self._read_about()
        if self._known.update(loops, now) or about != self.about:
            self.loops, self.about = self._known.loops, about
            for session in self.sessions:
                session.send(self.info(session.operates))
        self._take_services(served)

    def _read_about(self) -> str:
        with suppress(OSError):
            if self._config.about:
                line = Path(self._config.about).read_bytes()[:LINE]
                return one_line(line.decode("utf-8", "replace"))
        return ""

    def _ask_nodes(self) -> tuple[dict[str, dict[str, str]], dict[str, dict[str, str]]]:
        """Return the topics that every node publishes, and its services, with their types."""
        published: dict[str, dict[str, str]] = {}
        served: dict[str, dict[str, str]] = {}
        for name, space in self._node.get_node_names_and_namespaces():
            full = f"{space.rstrip('/')}/{name}"
            if full == self._node.get_fully_qualified_name():
                continue
            try:
                topics = self._node.get_publisher_names_and_types_by_node(name, space)
                services = self._node.get_service_names_and_types_by_node(name, space)
            except NodeNameNonExistentError:  # it has just ended
                continue
            published[full] = {topic: types[0] for topic, types in topics}
            served[full] = {service: types[0] for service, types in services}
        return published, served

    def _take_channels(self, topics: Mapping[str, str]) -> None:
        added = []
        for topic, kind in topics.items():
            if topic in self._types or len(self._types) >= MOST:
                continue
            self._types[topic] = kind
            try:
                message_type(kind)
                definition = load_schema(kind).text
            except KoopError as error:
                self.log(f"{topic} is not shown: {error}")
                continue
            added.append(AdvertisedChannel(next(self._numbers), topic, kind, definition))
        self.channels.update({channel.number: channel for channel in added})
        for session in self.sessions if added else ():
            session.send(protocol.advertise(added))

    def _take_services(self, served: Mapping[str, Mapping[str, str]]) -> None:
        """Offer the services of the loops' nodes."""
        added = []
        nodes = {
            node
            for loop in self.loops.values()
            for node in (loop.plant, loop.lifter, loop.controller, loop.guard)
            if node is not None and node in served
        }
        for name, type_name in sorted(item for node in nodes for item in served[node].items()):
            if name in self._types or type_name not in OFFERED:
                continue
            self._types[name] = type_name
            texts = load_service(type_name)
            added.append(AdvertisedService(next(self._numbers), name, type_name, *texts))
            if self._config.operate:
                self._caller.prepare(type_name, name)
        self.services.update({service.number: service for service in added})
        for session in self.sessions if added else ():
            session.send_services(added)

    # -- parameters and services --------------------------------------------------------------

    def _take_parameters(self, served: Mapping[str, object]) -> None:
        """Ask new nodes for their parameters, and forget the parameters of ended nodes."""
        values, name = self._collector.values, self._node.get_fully_qualified_name()
        for node in values.keys() - served.keys() - {name}:
            del values[node]
        if self._collector.look():
            for node in values.keys() - {name}:
                self._keep(node)

    def _keep(self, node: str) -> None:
        """Take over the parameters of a node, and announce those that have changed."""
        items = self._collector.values[node].items()
        values = {f"{node}.{name}": value for name, value in items}
        known = self.parameters.items()
        changed = {k: v for k, v in values.items() if (k, v) not in known}
        self.parameters.update(changed)
        for session in self.sessions if changed else ():
            session.send_parameters(changed)

    def _take_changes(self, events: list[bytes]) -> None:
        for data in events:
            event = read_message(data, ParameterEvent)
            values = None if event is None else self._collector.values.get(event.node)
            if values is None:
                continue
            for item in (*event.new_parameters, *event.changed_parameters):
                values[item.name] = read_value(item.value)
            self._keep(event.node)

    async def call(self, service: AdvertisedService, payload: bytes, peer: str) -> bytes:
        request = unpack(service, payload)
        try:
            answer = await self._caller.call(service.type_name, service.name, request)
        except Refused as error:
            self._note(service, peer, request, str(error))
            raise
        self._note(service, peer, request, describe(answer))
        return bytes(serialize_message(answer))

    def _note(self, service: AdvertisedService, peer: str, request: Any, outcome: str) -> None:
        """Log what an operator does."""
        self.log(f"{peer} operates: {service.name}({describe(request)}): {outcome}")

    def log(self, text: str) -> None:
        self._node.get_logger().info(one_line(text))


def _waiting(subscription: Any, kind: Any) -> Iterator[tuple[int, bytes]]:
    """Take the messages that wait: when each was received [ns], and the serialized message."""
    take = subscription.handle.take_message
    for _ in range(WAITING):
        item = take(kind, True)
        if item is None:
            return
        data, info = item
        # not every DDS gives the time of reception
        yield info["received_timestamp"] or time.time_ns(), data
