"""One loop in a namespace of a ROS domain: a second one detects the first and starts nothing."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

from koop_core.errors import LiveError
from koop_node.process.domain import current_domain, free_domain, only_observed

TOPICS = ("state", "cost", "theta", "koop_guard/state")  # that each have one publisher in a loop
PREFIX = "koop/"  # of the name that a loop holds, before its domain and its namespace
DISCOVERY = 4.0  # [s]: Fast DDS announces itself every 3 s, for those that missed the first time
ENDING = 6.0  # [s] in which the nodes of a loop end whose command was killed


@contextmanager
def alone(namespace: str = "", topics: Iterable[str] = TOPICS) -> Iterator[socket.socket]:
    """Hold the place of the one loop, which will publish these topics, while the context lasts.

    It gives the socket that holds the place, where :mod:`koop_node.client.desk` may answer.

    Two commands on one machine that start at the same moment are told apart by a name that the
    system gives to one of them only; a loop of other hosts, or of nodes that were started by hand,
    shows in the graph. Nodes whose command was just killed are given time to end.

    Raises LiveError if there is a loop already.
    """
    domain = current_domain()
    with claimed(f"{PREFIX}{domain}{namespace}") as (first, place_socket):
        if not first or _published(domain, [f"{namespace}/{topic}" for topic in topics]):
            place = f"{domain}, in the namespace {namespace}" if namespace else str(domain)
            raise LiveError(
                f"another loop runs on ROS domain {place}: it goes on, this one was not started. "
                f"Set ROS_DOMAIN_ID to a free one, such as {free_domain()}"
            )
        yield place_socket


@contextmanager
def claimed(name: str) -> Iterator[tuple[bool, socket.socket]]:
    """Take a name of the machine, or say that it is taken; the end of the process frees it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as place:
        first = False
        with suppress(OSError):
            place.bind(f"\0{name}")
            first = True
        yield first, place


def is_claimed(name: str) -> bool:
    """Return whether a process of this machine has taken a name."""
    with claimed(name) as (free, _):
        return not free


def is_empty(domain: int) -> bool:
    """Return whether it is certain that no node takes part in a ROS domain."""
    own_host = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") in ("LOCALHOST", "OFF")
    return own_host and not os.environ.get("ROS_STATIC_PEERS") and only_observed(domain)


def _published(domain: int, topics: list[str]) -> bool:
    """Return whether one of the topics has a publisher that stays."""
    if not topics or is_empty(domain):
        return False
    from koop_node.client.client import Client  # needs ROS

    with Client("koop_look") as client:

        def is_published() -> bool:
            return any(client.node.count_publishers(topic) for topic in topics)

        return client.spin_until(is_published, DISCOVERY) and not client.spin_until(
            lambda: not is_published(), ENDING
        )
