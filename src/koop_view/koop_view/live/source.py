"""What runs in a ROS domain, as a source."""

from __future__ import annotations

import asyncio
import math
import time
from array import array
from collections.abc import Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.serialization import deserialize_message

from koop_bag.bag.topics import COMMON_TOPICS, is_common
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_bag.recorder.parameters import ParameterCollector
from koop_bag.recorder.topics import message_class
from koop_core.errors import one_line
from koop_view.live.services import Caller, load, packed, unpacked
from koop_view.live.starting import Starting
from koop_view.live.topic import ViewedTopic
from koop_view.protocol import WARNING, Channel, Service
from koop_view.roles import Known, loops
from koop_view.source import Client, Refused, Source

POLL = 0.02  # [s] between looks for messages while somebody looks
IDLE = 0.1  # [s] while nobody does
LOOK = 0.5  # [s] between looks at the graph
EVENTS = 20  # of the executor at a time
LINE = 200  # bytes of what is shown beside the loops
MOST = 1000  # channels, services, loops: what a domain gone mad may cost
DIAGNOSTICS, CHANGES = "/diagnostics", "/parameter_events"
_SET = "rcl_interfaces/srv/SetParametersAtomically"


class LiveSource(Source):
    """The loops of a ROS domain.

    Parameters
    ----------
    node : rclpy.node.Node
        As which it takes part.
    executor : object
        Of the node; it is polled here.
    rate : float
        Messages a second of one topic [1/s].
    operates : bool
        Whether anybody may operate.
    about : str
        File with the line that is shown beside the loops; empty: none.
    """

    mode = "live"

    def __init__(
        self, node: Node, executor: Any, rate: float, operates: bool, about: str = ""
    ) -> None:
        super().__init__()
        self._node, self._executor = node, executor
        self._rate, self._operates = rate, operates
        self._about = about
        self._caller = Caller(node)
        self._collector = ParameterCollector(node, "/")
        self._starting = Starting()
        self._known = Known()
        self._publishers: dict[str, set[str]] = {}  # nodes by topic
        self._nameless: set[str] = set()  # topics of what is no ROS node
        self._types: dict[str, str] = {}  # of topics and services that were looked at
        self._topics: dict[str, ViewedTopic] = {}
        self._viewers: dict[str, list[tuple[Client, int]]] = {}
        self._numbers = iter(range(1, 2**32))
        for name in (DIAGNOSTICS, CHANGES):
            self._topics[name] = self._listen(name, COMMON_TOPICS[name])

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

    def subscribe(self, client: Client, wanted: Mapping[int, Channel]) -> None:
        for subscription, channel in wanted.items():
            self._viewers.setdefault(channel.topic, []).append((client, subscription))
        self._choose(time.monotonic())

    def unsubscribe(self, client: Client, subscription: int, channel: Channel) -> None:
        left = [item for item in self._viewers[channel.topic] if item != (client, subscription)]
        self._viewers[channel.topic] = left
        if not left:
            del self._viewers[channel.topic]
        self._choose(time.monotonic())

    def _choose(self, now: float) -> None:
        """Listen to what somebody looks at, but to no node that still waits for its loop.

        Nor to a topic that nobody publishes: whoever comes next may be such a node.
        """
        wanted = {DIAGNOSTICS, CHANGES}
        for name in self._viewers:
            nodes = self._publishers.get(name, ())
            waits = any(self._starting.waits(node, now) for node in nodes)
            if is_common(name) or name in self._nameless or (nodes and not waits):
                wanted.add(name)
        for name in self._topics.keys() - wanted:
            self._topics.pop(name).close()
        for name in wanted - self._topics.keys():
            self._topics[name] = self._listen(name, self._types[name])

    def _listen(self, name: str, type_name: str) -> ViewedTopic:
        common = name in COMMON_TOPICS
        return ViewedTopic(self._node, name, type_name, self._rate, common, name == "/rosout")

    def _poll(self, now: float) -> None:
        for _ in range(EVENTS if self._caller.waiting else 2):
            self._executor.spin_once(timeout_sec=0.0)
        for name, topic in list(self._topics.items()):
            taken = topic.take()
            for client, subscription in self._viewers.get(name, ()):
                for received, data in taken:
                    client.deliver(subscription, received, data)
                if topic.left_out:
                    client.say(
                        WARNING,
                        f"{name} comes faster than {self._rate:g} Hz: not all of it is sent",
                        f"rate of {name}",
                    )
            topic.left_out = False
            if name == DIAGNOSTICS:
                self._hear([data for _, data in taken], now)
            elif name == CHANGES:
                self._take_changes([data for _, data in taken])

    def _hear(self, reports: list[bytes], now: float) -> None:
        for data in reports:
            for status in deserialize_message(data, DiagnosticArray).status:
                values = {item.key: item.value for item in status.values}
                if "lifecycle_state" not in values:
                    continue
                active = values["lifecycle_state"] == "active"
                works = values.get("rate_hz", "0.0") != "0.0"
                if self._starting.hear(status.name, works, active, now):
                    # it may be another process of the same name
                    self._collector.values.pop(status.name, None)

    # -- the graph ----------------------------------------------------------------------------

    def _look(self, now: float) -> None:
        published, served = self._ask_nodes()
        self._publishers = {}
        for node, topics in published.items():
            for topic in topics:
                self._publishers.setdefault(topic, set()).add(node)
        managed = {node for node, names in served.items() if f"{node}/change_state" in names}
        self._starting.see(published, now)
        self._take_parameters(served)
        self._take_channels()
        nameless = {
            topic: types[0]
            for topic, types in self._node.get_topic_names_and_types()
            if topic not in self._publishers and self._node.count_publishers(topic)
        }
        self._nameless = set(nameless)
        found = dict(islice(loops(published, nameless, managed).items(), MOST))
        about = self._read_about()
        if self._known.see(found, now) or about != self.about:
            self.loops, self.about = self._known.loops, about
            self._tell("news_of_loops")
        self._take_services(served)
        self._choose(now)

    def _read_about(self) -> str:
        with suppress(OSError):
            if self._about:
                return one_line(Path(self._about).read_bytes()[:LINE].decode("utf-8", "replace"))
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
            except NodeNameNonExistentError:  # it has just gone
                continue
            published[full] = {topic: types[0] for topic, types in topics}
            served[full] = {service: types[0] for service, types in services}
        return published, served

    def _take_channels(self) -> None:
        added, gone = [], []
        known = {channel.topic: channel for channel in self.channels.values()}
        for topic, types in self._node.get_topic_names_and_types():
            if self._types.get(topic) == types[0] or len(self._types) >= MOST:
                continue
            if not self._node.count_publishers(topic):
                continue
            self._types[topic] = types[0]
            try:
                message_class(types[0])
                definition = load_schema(types[0]).text
            except BagError as error:
                self.log(f"{topic} is not shown: {error}")
                continue
            if topic in known:
                gone.append(known[topic].number)
            added.append(Channel(next(self._numbers), topic, types[0], definition))
        for number in gone:
            del self.channels[number]
        self.channels.update({channel.number: channel for channel in added})
        if added:
            self._tell("news_of_channels", added, gone)

    def _take_services(self, served: Mapping[str, Mapping[str, str]]) -> None:
        """Offer the services of the loops' nodes."""
        added = []
        nodes = {
            node
            for loop in self.loops.values()
            for node in (loop.plant, loop.lifter, loop.controller)
            if node is not None and node in served
        }
        for name, type_name in sorted(item for node in nodes for item in served[node].items()):
            if name in self._types or len(self._types) >= 2 * MOST:
                continue
            self._types[name] = type_name
            try:
                service = load(next(self._numbers), name, type_name)
            except BagError:
                continue
            added.append(service)
            if self._operates and service.operates:
                self._caller.prepare(type_name, name)
        self.services.update({service.number: service for service in added})
        if added:
            self._tell("news_of_services", added)

    def _tell(self, news: str, *what: Any) -> None:
        if self.listener is not None:
            getattr(self.listener, news)(*what)

    # -- parameters and services --------------------------------------------------------------

    def _take_parameters(self, served: Mapping[str, object]) -> None:
        """Ask nodes that are new for their parameters, and forget those that are gone."""
        values, own = self._collector.values, self._node.get_fully_qualified_name()
        for node in values.keys() - served.keys() - {own}:
            del values[node]
        if self._collector.look():
            self._keep(
                {f"{n}.{k}": v for n, it in values.items() if n != own for k, v in it.items()}
            )

    def _keep(self, values: Mapping[str, Any]) -> None:
        changed = {
            name: value
            for name, value in values.items()
            if name not in self.parameters or self.parameters[name] != value
        }
        self.parameters.update(changed)
        if changed:
            self._tell("news_of_parameters", changed)

    def _take_changes(self, events: list[bytes]) -> None:
        for data in events:
            event = deserialize_message(data, ParameterEvent)
            own = self._collector.values.get(event.node)
            if own is None:
                continue
            for item in (*event.new_parameters, *event.changed_parameters):
                value = parameter_value_to_python(item.value)
                own[item.name] = list(value) if isinstance(value, array | tuple) else value
            self._keep({f"{event.node}.{name}": value for name, value in own.items()})

    async def set_parameters(self, values: Mapping[str, Any], peer: str) -> None:
        by_node: dict[str, list[Any]] = {}
        for full, value in values.items():
            node, _, name = full.partition(".")
            if full not in self.parameters:
                raise Refused(f"there is no parameter {full[:100]}: nothing was changed")
            by_node.setdefault(node, []).append(_parameter(name, value, self.parameters[full]))
        for node, parameters in by_node.items():
            request = SetParametersAtomically.Request(parameters=parameters)
            service = f"{node}/set_parameters_atomically"
            answer = await self._operate(_SET, service, request, peer)
            if not answer.result.successful:
                raise Refused(f"{node} refuses: {answer.result.reason}")

    async def call(self, service: Service, payload: bytes, peer: str) -> bytes:
        request = unpacked(service, payload)
        if not service.operates:
            return packed(await self._caller.call(service.type_name, service.name, request))
        return packed(await self._operate(service.type_name, service.name, request, peer))

    async def _operate(self, type_name: str, name: str, request: Any, peer: str) -> Any:
        """Call what moves or changes the rig, and write it down."""
        what = f"{peer} operates: {name}({_told(request)})"
        try:
            answer = await self._caller.call(type_name, name, request)
        except Refused as error:
            self.log(f"{what}: {error}")
            raise
        self.log(f"{what}: {_told(answer)}")
        return answer

    def log(self, text: str) -> None:
        self._node.get_logger().info(one_line(text))


def _parameter(name: str, value: Any, known: Any) -> Any:
    """Return a parameter of the type that it has: JSON knows one kind of numbers."""
    if isinstance(known, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if abs(value) < 2**63 else math.inf
    if isinstance(value, list) and all(type(item) in (int, float) for item in value):
        value = [float(item) for item in value] if _has_floats(known) else value
    try:
        return Parameter(name, value=value).to_parameter_msg()
    except (TypeError, ValueError, AssertionError, OverflowError):
        raise Refused(f"{name}: a value that no parameter can have: nothing was changed") from None


def _has_floats(known: Any) -> bool:
    return isinstance(known, list) and (not known or isinstance(known[0], float))


def _told(message: Any) -> str:
    """Return what a request or an answer says, in a few words."""
    if hasattr(message, "parameters"):
        pairs = [(p.name, parameter_value_to_python(p.value)) for p in message.parameters]
        return ", ".join(f"{name}={value}" for name, value in pairs)
    if hasattr(message, "transition"):
        return str(message.transition.label or message.transition.id)
    if hasattr(message, "result") and hasattr(message.result, "successful"):
        return "done" if message.result.successful else f"refused: {message.result.reason}"
    fields = message.get_fields_and_field_types()
    return ", ".join(f"{name}={getattr(message, name)}" for name in fields)
