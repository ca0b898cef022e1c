"""What the server shows: a loop or a recording, the same way to a client. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Protocol

from koop_view.protocol import AdvertisedChannel, AdvertisedService


class Refused(Exception):
    """A client's request was not carried out; the text says why."""


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


class Viewer(Protocol):
    """A client, as a source sees it."""

    def deliver(self, subscription: int, time: int, data: bytes) -> None:
        """Send a message of a channel, whether or not the client keeps up."""

    async def deliver_slowly(self, subscription: int, time: int, data: bytes) -> bool:
        """Send a message as soon as the client takes it; False if it has unsubscribed."""

    def say(self, level: int, text: str, identifier: str | None = None) -> None:
        """Show a text to the user of the client."""


class SourceListener(Protocol):
    """Passes news of a source on to all clients."""

    def change_channels(self, added: list[AdvertisedChannel], ended: list[int]) -> None:
        """Announce channels."""

    def add_services(self, added: list[AdvertisedService]) -> None:
        """Announce services."""

    def change_parameters(self, values: Mapping[str, Any]) -> None:
        """Announce parameters that have changed."""

    def change_loops(self) -> None:
        """Announce the loops."""


class ViewSource:
    """What is shown; the base class shows nothing."""

    mode: ClassVar[str] = ""
    listener: SourceListener

    def __init__(self) -> None:
        self.channels: dict[int, AdvertisedChannel] = {}
        self.services: dict[int, AdvertisedService] = {}
        self.parameters: dict[str, Any] = {}
        """By name, such as ``/relay_esc.dwell``."""
        self.loops: dict[str, LoopNames] = {}
        """By namespace."""
        self.about = ""
        """What the command that runs the loops does now."""

    def loops_json(self) -> str:
        """Return the loops as JSON."""
        return json.dumps([asdict(loop) for _, loop in sorted(self.loops.items())])

    def subscribe(self, viewer: Viewer, wanted: Mapping[int, AdvertisedChannel]) -> None:
        """Begin to deliver channels, by the numbers of the subscriptions."""

    def unsubscribe(self, viewer: Viewer, subscription: int, channel: AdvertisedChannel) -> None:
        """Stop delivering a channel."""

    async def call(self, service: AdvertisedService, payload: bytes, peer: str) -> bytes:
        """Call a service and return its answer.

        Raises
        ------
        Refused
            If it could not be called, or did not answer.
        """
        raise Refused("a recording answers no calls")

    def log(self, text: str) -> None:
        """Write a line where the operator looks afterwards."""
