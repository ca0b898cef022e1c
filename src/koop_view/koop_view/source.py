"""What the server shows: the same to a client, whether it is a loop or a recording. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Protocol

from koop_view.protocol import Channel, Service


class Refused(Exception):
    """What a client asked was not done; the text says why."""


@dataclass(frozen=True)
class Loop:
    """One loop: full names of its nodes and topics, None where there is none."""

    namespace: str
    plant: str | None = None
    lifter: str | None = None
    controller: str | None = None
    state: str | None = None
    cost: str | None = None
    theta: str | None = None


class Client(Protocol):
    """What a source sees of a client."""

    peer: str

    def deliver(self, subscription: int, time: int, data: bytes) -> None:
        """Send a message of a channel, whether or not the client keeps up."""

    async def deliver_slowly(self, subscription: int, time: int, data: bytes) -> None:
        """Send a message as soon as the client takes it."""

    def say(self, level: int, text: str, identifier: str | None = None) -> None:
        """Show a text to whoever looks at the client."""


class Listener(Protocol):
    """Who passes news on to all clients."""

    def news_of_channels(self, added: list[Channel], gone: list[int]) -> None:
        """Tell of channels."""

    def news_of_services(self, added: list[Service]) -> None:
        """Tell of services."""

    def news_of_parameters(self, values: Mapping[str, Any]) -> None:
        """Tell of parameters that have changed."""

    def news_of_loops(self) -> None:
        """Tell of loops."""


class Source:
    """Base of what is shown; nothing yet."""

    mode: ClassVar[str] = ""

    def __init__(self) -> None:
        self.channels: dict[int, Channel] = {}
        self.services: dict[int, Service] = {}
        self.parameters: dict[str, Any] = {}
        """By name, such as ``/relay_esc.dwell``."""
        self.loops: dict[str, Loop] = {}
        """By namespace."""
        self.about = ""
        """What whoever started the loops does now, in words."""
        self.listener: Listener | None = None

    def loops_text(self) -> str:
        """Return the loops as JSON."""
        return json.dumps([asdict(loop) for _, loop in sorted(self.loops.items())])

    def subscribe(self, client: Client, wanted: Mapping[int, Channel]) -> None:
        """Begin to deliver channels, given by the numbers of the subscriptions."""

    def unsubscribe(self, client: Client, subscription: int, channel: Channel) -> None:
        """Deliver a channel no more."""

    async def call(self, service: Service, payload: bytes, peer: str) -> bytes:
        """Call a service and return its answer.

        Raises
        ------
        Refused
            If it could not be called, or did not answer.
        """
        raise Refused("a recording answers no calls")

    async def set_parameters(self, values: Mapping[str, Any], peer: str) -> None:
        """Change parameters, those of a node all or none.

        Raises
        ------
        Refused
            If a node refuses, or does not answer.
        """
        raise Refused("the parameters of a recording are what they were")

    def log(self, text: str) -> None:
        """Write a line where the operator looks afterwards."""
