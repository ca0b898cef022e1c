"""Publishers and subscribers of a topic by name, as the graph of the ROS domain shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription

from koop_core.errors import LiveError

NEXT = "next"
"""Among the listeners of a node: the next node of the loop, whatever its name is."""
LOOP_TYPES = {f"koop_msgs/msg/{name}" for name in ("MeasuredState", "Cost", "ControlInput")}
COST = "koop_msgs/msg/Cost"
SHARED = {"/clock", "/parameter_events", "/rosout"}  # say nothing about what a node works with
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of rmw, while the name is on its way
BARE = "_CREATED_BY_BARE_DDS_APP_"  # of rmw, for a program that is not a node of ROS


@dataclass(frozen=True)
class Listeners:
    """Which nodes must listen to a topic before its publisher begins.

    An observer, such as ``ros2 topic echo``, is none of them, however many there are.
    """

    names: tuple[str, ...] = ()
    next: str = ""
    """Besides those named: ``loop``, a node that publishes a message of the loop; ``any``."""

    def missing(self, node: Node, publisher: Publisher, reader: str = "") -> str:
        """Return in words which nodes do not listen yet; empty if all do.

        One reads the messages without a subscription: in :mod:`koop_core.journal`.
        """
        kind = type_name(publisher.msg_type)
        infos = [
            info
            for info in node.get_subscriptions_info_by_topic(publisher.topic_name)
            if info.topic_type == kind and _compatible(publisher.qos_profile, info.qos_profile)
        ]
        names = {info.node_name for info in infos}
        missing = [name for name in self.names if name not in {*names, reader}]
        others = [info for info in infos if info.node_name not in self.names]
        if self.next == "loop" and not any(_in_loop(node, info) for info in others):
            missing.append("the next node of the loop")
        if self.next == "any" and not any(_visible(info) for info in others):
            missing.append("the rig")
        more = len(infos) - publisher.get_subscription_count()
        if not missing and more > 0:  # announced, and not connected yet
            missing.append(f"{more} more")
        return ", ".join(missing)


def listeners_of(text: str, next_: str) -> tuple[Listeners, Listeners]:
    """Return the listeners that must hear a node's answers, and its other topics.

    ``text`` is the parameter ``listeners``, ``next_`` what its :data:`NEXT` is.
    """
    words = text.split()
    names = tuple(word for word in words if word != NEXT)
    return Listeners(names, next_ if NEXT in words else ""), Listeners(names)


def publishers_of(node: Node, topic: str) -> list[Any]:
    """Return the publishers of a topic, also those that this node cannot hear."""
    return list(node.get_publishers_info_by_topic(topic))


def identify_publishers(node: Node, topic: str) -> set[str]:
    """Return an id of each publisher of a topic; a program that was started again has another."""
    return _identify(publishers_of(node, topic))


def identify_subscribers(node: Node, topic: str) -> set[str]:
    """Return an id of each subscription of a topic, but for those of observers that hide."""
    return _identify(subscribers_of(node, topic))


def subscribers_of(node: Node, topic: str) -> list[Any]:
    """Return the subscriptions of a topic by nodes that do not hide as observers."""
    return [info for info in node.get_subscriptions_info_by_topic(topic) if _visible(info)]


def message_type_of(topic: str, endpoints: Sequence[Any]) -> str:
    """Return the message type that the endpoints of a topic have, ``pkg/msg/Type``.

    Raises LiveError if they have several.
    """
    first, *others = sorted({info.topic_type for info in endpoints})
    if others:
        raise LiveError(f"{topic} has several message types: {', '.join([first, *others])}")
    return str(first)


def unheard(subscription: Subscription, publishers: Sequence[Any]) -> list[str]:
    """Name every publisher that a subscription cannot hear, and why."""
    wanted = type_name(subscription.msg_type)
    texts = []
    for info in publishers:
        if info.topic_type != wanted:
            why = f"as {info.topic_type}, not as {wanted}"
        elif not _compatible(info.qos_profile, subscription.qos_profile):
            why = "with a quality of service that does not fit"
        else:
            continue
        texts.append(f"'{subscription.topic_name}' is published by {full_name(info)} {why}")
    return texts


def can_say_more(node: Node, publishers: Sequence[Any]) -> bool:
    """Return whether a publisher is there that may have something to say.

    A lifter whose own input has no publisher has not: its source has left.
    """
    return any(_has_source(node, info) for info in publishers)


def type_name(kind: Any) -> str:
    """Return ``pkg/msg/Type`` of a message class."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def full_name(info: Any) -> str:
    """Return the name of the node that an endpoint belongs to."""
    if info.node_name in (UNKNOWN, BARE):
        return "a program that is not a node of ROS"
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def _identify(infos: Sequence[Any]) -> set[str]:
    return {bytes(info.endpoint_gid).hex() for info in infos}


def _has_source(node: Node, info: Any) -> bool:
    if info.topic_type != COST or info.node_name in (UNKNOWN, BARE):
        return True  # a plant listens, too, and is a source all the same
    try:
        heard = node.get_subscriber_names_and_types_by_node(info.node_name, info.node_namespace)
    except NodeNameNonExistentError:  # it is leaving, or is not a node of ROS
        return True
    inputs = [name for name, _ in heard if name not in SHARED]
    return not inputs or any(node.count_publishers(name) for name in inputs)


def _in_loop(node: Node, info: Any) -> bool:
    if info.node_name == UNKNOWN:  # its name may still be on its way
        return False
    try:
        published = node.get_publisher_names_and_types_by_node(info.node_name, info.node_namespace)
    except NodeNameNonExistentError:
        return False
    return any(LOOP_TYPES.intersection(types) for _, types in published)


def _visible(info: Any) -> bool:
    return info.node_name in (UNKNOWN, BARE) or not info.node_name.startswith("_")


def _compatible(offered: Any, wanted: Any) -> bool:
    """Return whether a subscription can hear a publisher, by what can differ here.

    rclpy's own check takes a deadline that is not given for one of 0 s.
    """
    reliable, local = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
    return (wanted.reliability != reliable or offered.reliability == reliable) and (
        wanted.durability != local or offered.durability == local
    )
