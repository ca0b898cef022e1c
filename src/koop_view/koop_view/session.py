"""A client with its subscriptions, rights and limits, and the source that clients are shown."""

from __future__ import annotations

import asyncio
import json
import secrets
import time
from collections.abc import Coroutine, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any, ClassVar

from websockets.asyncio.connection import Connection, broadcast
from websockets.exceptions import ConnectionClosed

from koop_view import protocol
from koop_view.protocol import (
    ERROR,
    WARNING,
    AdvertisedChannel,
    AdvertisedService,
    ProtocolError,
)
from koop_view.roles import LoopNames

BACKLOG = 4_000_000  # [B] that may wait for a client
CALLS = 8  # that may wait for their answers
POLICY_VIOLATION = 1008  # RFC 6455, section 7.4.1
PATIENCE = 5.0  # [s] for a client that is dropped to take the reason


class Budget:
    """How often something may happen: at a rate [1/s], and so many times at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._time = burst, time.monotonic()

    def take(self) -> bool:
        """Return whether it may happen now."""
        now = time.monotonic()
        self._left = min(self._burst, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Refused(Exception):
    """A client's request was not carried out; the text says why."""


class ViewSource:
    """A loop or a recording that is shown; the base class shows nothing."""

    mode: ClassVar[str] = ""

    def __init__(self) -> None:
        self.sessions: set[ClientSession] = set()
        self.channels: dict[int, AdvertisedChannel] = {}
        self.services: dict[int, AdvertisedService] = {}
        """Services that move or change the rig."""
        self.parameters: dict[str, Any] = {}
        """By name, such as ``/relay_esc.dwell``."""
        self.loops: dict[str, LoopNames] = {}
        """By namespace."""
        self.about = ""
        """Line about the command that runs the loops."""
        self._identity = secrets.token_hex(8)
        self._lines = Budget(1.0, 10.0)  # the log is recorded

    def info(self, operates: bool) -> str:
        """Return the first message to a client, which comes again when the loops change."""
        capabilities = ["parameters", "parametersSubscribe"]
        capabilities += ["services"] if self.mode == "live" else []
        metadata = {
            "koop_mode": self.mode,
            "koop_operate": "true" if operates else "false",
            "koop_loops": json.dumps([asdict(loop) for _, loop in sorted(self.loops.items())]),
            "koop_about": self.about,
        }
        return protocol.server_info("koop", capabilities, metadata, self._identity)

    def subscribe(self, viewer: ClientSession, wanted: Mapping[int, AdvertisedChannel]) -> None:
        """Begin to deliver channels, by the numbers of the subscriptions."""

    def unsubscribe(
        self, viewer: ClientSession, subscription: int, channel: AdvertisedChannel
    ) -> None:
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

    def log_refusal(self, text: str) -> None:
        """Log a line about a client, unless there were many."""
        if self._lines.take():
            self.log(text)


class ClientSession:
    """A client, and whether it may operate."""

    def __init__(self, connection: Connection, source: ViewSource, operates: bool) -> None:
        self.operates = operates
        host, port, *_ = connection.remote_address or ("?", 0)
        self.peer = f"{host}:{port}"
        self._connection = connection
        self._source = source
        self._messages = Budget(200.0, 1000.0)
        self._subscriptions: dict[int, AdvertisedChannel] = {}
        self._watched: set[str] | None = set()  # None: all
        self._tasks: set[asyncio.Task[None]] = set()
        self._dropped = False

    # -- messages of the server -----------------------------------------------------------------

    def send(self, message: str | bytes) -> None:
        """Send at once, whether or not the client keeps up."""
        if not self._dropped:
            broadcast((self._connection,), message)

    def say(self, level: int, text: str) -> None:
        """Show a text to the user of the client."""
        self.send(protocol.status(level, text))

    def deliver(self, subscription: int, time: int, data: bytes) -> None:
        """Send a message of a channel, whether or not the client keeps up."""
        self.send(protocol.message_data(subscription, time, data))

    async def deliver_slowly(self, subscription: int, time: int, data: bytes) -> bool:
        """Send a message as soon as the client takes it; False if it has unsubscribed."""
        if subscription not in self._subscriptions:
            return False
        await self._connection.send(protocol.message_data(subscription, time, data))
        return True

    def send_services(self, services: Iterable[AdvertisedService]) -> None:
        """Announce services, if the client may call them."""
        if self.operates:
            self.send(protocol.advertise_services(services))

    def send_parameters(self, values: Mapping[str, Any]) -> None:
        """Tell of changed parameters, as far as the client wants to know."""
        watched = self._watched
        wanted = {k: v for k, v in values.items() if watched is None or k in watched}
        if wanted:
            self.send(protocol.parameter_values(wanted, None))

    def check_backlog(self) -> None:
        """Drop the client if it does not keep up."""
        waiting = self._connection.transport.get_write_buffer_size()
        if waiting > BACKLOG:
            self.drop(f"too slow: {waiting / 1e6:.1f} MB are waiting")

    def drop(self, reason: str) -> None:
        """Disconnect the client, with the reason."""
        if self._dropped:
            return
        self._dropped = True
        self._source.log_refusal(f"dropped: {self.peer}: {reason}")
        self.close()
        transport = self._connection.transport
        asyncio.get_running_loop().call_later(PATIENCE, transport.abort)
        self._start(self._connection.close(POLICY_VIOLATION, reason))

    def close(self) -> None:
        """End what the client has asked for."""
        for number in list(self._subscriptions):
            self._unsubscribe(number)
        for task in self._tasks:
            task.cancel()

    # -- requests of the client -----------------------------------------------------------------

    def receive(self, message: str | bytes) -> None:
        """Carry out a request of the client."""
        if self._dropped:
            return
        if not self._messages.take():
            self.drop("too many messages")
            return
        try:
            self._carry_out(protocol.parse(message))
        except ProtocolError as error:
            self.say(ERROR, f"not a request: {error}")

    def _carry_out(self, request: protocol.Request) -> None:
        match request:
            case protocol.Subscribe(items):
                self._subscribe(items)
            case protocol.Unsubscribe(numbers):
                for number in numbers:
                    self._unsubscribe(number)
            case protocol.GetParameters(names, identifier):
                values = self._source.parameters
                if names:
                    values = {name: values[name] for name in names if name in values}
                self.send(protocol.parameter_values(values, identifier))
            case protocol.WatchParameters(names, wanted):
                self._watch(names, wanted)
            case protocol.Call():
                self._call(request)

    def _subscribe(self, items: Iterable[tuple[int, int]]) -> None:
        wanted: dict[int, AdvertisedChannel] = {}
        for number, channel in items:
            advertised = self._source.channels.get(channel)
            if advertised is None:
                self.say(WARNING, f"there is no channel {channel}")
            elif number in self._subscriptions or len(self._subscriptions) >= protocol.MANY:
                self.say(WARNING, f"subscription {number} is taken, or there are too many")
            else:
                self._subscriptions[number] = wanted[number] = advertised
        if wanted:
            self._source.subscribe(self, wanted)

    def _unsubscribe(self, number: int) -> None:
        channel = self._subscriptions.pop(number, None)
        if channel is not None:
            self._source.unsubscribe(self, number, channel)

    def _watch(self, names: tuple[str, ...], wanted: bool) -> None:
        if not names:
            self._watched = None if wanted else set()
        elif self._watched is not None and not wanted:
            self._watched -= set(names)
        elif self._watched is not None and len(self._watched | set(names)) <= protocol.MANY:
            self._watched |= set(names)  # also names of a node that is still to come

    def _call(self, call: protocol.Call) -> None:
        service = self._source.services.get(call.service)
        reason = ""
        if not self.operates:
            reason = "may only read: a call takes the token that 'koop serve --operate' prints"
            self._source.log_refusal(f"refused: {self.peer} {reason}")
        elif call.encoding != protocol.ENCODING:
            reason = f"the encoding must be {protocol.ENCODING}"
        elif len(self._tasks) >= CALLS:
            reason = "too many calls"
        elif service is not None:
            self._start(self._answer(service, call))
            return
        reason = reason or f"there is no service {call.service}"
        self.send(protocol.call_failed(call.service, call.call, reason))

    async def _answer(self, service: AdvertisedService, call: protocol.Call) -> None:
        try:
            payload = await self._source.call(service, call.payload, self.peer)
        except Refused as error:
            self.send(protocol.call_failed(call.service, call.call, str(error)))
        else:
            self.send(protocol.answer(call.service, call.call, payload))

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        async def guarded() -> None:
            with suppress(ConnectionClosed):
                await work

        task = asyncio.get_running_loop().create_task(guarded())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
