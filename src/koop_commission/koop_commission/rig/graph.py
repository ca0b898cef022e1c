"""Topics and their publishers in the live ROS graph, compared with a rig file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from koop_core.config.fields import (
    format_field,
    numbers_of,
    read_field,
    write_field,
)
from koop_core.errors import KoopError, LiveError
from koop_core.stream.report import GHOST
from koop_node.client.alone import DISCOVERY
from koop_node.client.client import Client
from koop_node.node.graph import full_name, message_type_of, publishers_of, subscribers_of
from koop_tune.rig.rig_file import STATE, STATE_TYPE, THETA_TYPE, RigFile

HIDDEN = ("/rosout", "/parameter_events", "/diagnostics", "/clock", "/tf", "/tf_static")


class Topic(NamedTuple):
    """A topic of the graph.

    Attributes
    ----------
    name, type : str
        Full name; ``pkg/msg/Type``.
    publishers, subscribers : tuple of str
        The nodes, by their full names; a program of another DDS has none.
    """

    name: str
    type: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]


def find_topics(client: Client, until: Callable[[], object] = lambda: False) -> list[Topic]:
    """Return the topics of other nodes, after the time of discovery or once ``until`` is true."""
    client.spin_until(until, DISCOVERY)
    topics = []
    for name, kinds in client.node.get_topic_names_and_types():
        if name in HIDDEN or "/_" in name or name.endswith("/transition_event"):
            continue
        publishers, subscribers = find_nodes(client, name)
        if publishers or subscribers:
            topics.append(Topic(name, kinds[0], publishers, subscribers))
    return sorted(topics)


def find_nodes(client: Client, topic: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the other nodes that publish and that subscribe to a topic."""
    node = client.node

    def names(infos: Sequence[Any]) -> tuple[str, ...]:
        return tuple(full_name(info) for info in infos if info.node_name != node.get_name())

    return (
        names(node.get_publishers_info_by_topic(topic)),
        names(node.get_subscriptions_info_by_topic(topic)),
    )


def describe_other_commanders(client: Client, rig: RigFile) -> str:
    """Return in words that others command the rig; empty: none does."""
    for source in rig.command_sources:
        if names := sorted(set(find_nodes(client, source.topic)[0])):
            return f"{source.topic} is commanded by {', '.join(names)}: stop that ({GHOST})"
    return ""


def describe_rest(rig: RigFile, command_types: Sequence[str]) -> str:
    """Return in words what a command sends but theta as it is; empty: nothing."""
    from koop_node.node.managed import message_type

    for source, kind in zip(rig.command_sources, command_types, strict=True):
        message = message_type(kind)()
        for path in source.fields:
            write_field(path, message, 0.5)
            if read_field(path, message) != 0.5:
                field = f"{source.topic}: {format_field(path)}"
                return f"{field} takes whole numbers: theta is rounded, set limits that are"
        rest = [path for path in numbers_of(message) if path not in source.fields]
        if rest and kind != THETA_TYPE:
            sent = ", ".join(f"{format_field(p)} = {read_field(p, message):g}" for p in rest)
            return f"{source.topic} is always sent with {sent}: is that safe? Else name it, too"
    return ""


def describe_second_rig(client: Client, rig: RigFile) -> str:
    """Return in words that the measured topic has more than one publisher; empty: it has not."""
    names = find_nodes(client, rig.measured_source.topic)[0]
    if len(names) < 2:
        return ""
    return (
        f"{rig.measured_source.topic} is published by {' and '.join(names)}: stop all but the rig "
        f"({GHOST})"
    )


def find_types(client: Client, rig: RigFile) -> tuple[str, list[str]]:
    """Return the message type that a rig publishes, and those of the topics of its command.

    Raises
    ------
    koop_core.errors.LiveError
        If a signal has no publisher or the command no subscriber, a topic has several
        message types, or the rig publishes another one on the loop's own topic.
    koop_core.config.parameter.ConfigError
        If a type is not installed or has no such field.
    """
    from koop_node.node.managed import message_type

    sides = [
        ("measured", "publisher", rig.measured_source, publishers_of),
        *(("command", "subscriber", s, subscribers_of) for s in rig.command_sources),
    ]
    if rig.bounded is not None:
        sides.append(("constraint", "publisher", rig.bounded.source, publishers_of))
    topics = find_topics(
        client, lambda: all(ends(client.node, source.topic) for *_, source, ends in sides)
    )
    types = []
    for key, role, source, ends in sides:
        if not (endpoints := ends(client.node, source.topic)):
            offered = [
                t for t in topics if (t.publishers if role == "publisher" else t.subscribers)
            ]
            others = ", ".join(f"{t.name} ({t.type})" for t in offered[:8]) or "none"
            raise LiveError(
                f"{key}: {source.topic} has no {role}: is the rig running, in this ROS domain? "
                f"Topics with a {role}: {others}"
            )
        try:
            kind = message_type_of(source.topic, endpoints)
            message_type(kind, source.fields)
        except KoopError as error:
            raise type(error)(f"{key}: {error}") from None
        types.append(kind)
    measured, *commands = types
    if rig.measured_source.topic == STATE and measured != STATE_TYPE:
        raise LiveError(
            f"measured: {STATE} is {measured}, for the lifter it is {STATE_TYPE}: let the rig "
            "publish on another topic"
        )
    return measured, commands[: len(rig.commands)]
