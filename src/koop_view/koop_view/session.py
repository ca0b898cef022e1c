"""One client: what it subscribed to, what it may do, and how much it may ask."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterable
from contextlib import suppress
from typing import Any

from websockets.asyncio.connection import Connection, broadcast
from websockets.exceptions import ConnectionClosed

from koop_view import protocol
from koop_view.protocol import ERROR, WARNING, Channel, ProtocolError, Service
from koop_view.source import Refused, Source

CALLS = 8  # that may wait for their answers
TOO_SLOW, TOO_MANY = 1008, 1008  # "policy violation", RFC 6455 section 7.4.1
PATIENCE = 5.0  # [s] for a client that is dropped to take the reason


class Budget:
    """How often something may happen: at a rate [1/s], and so many times at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._time = burst, time.monotonic()

    def take(self, count: float = 1.0) -> bool:
        """Return whether it may happen now."""
        now = time.monotonic()
        self._left = min(self._burst, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < count:
            return False
        self._left -= count
        return True


class Shared:
    """What clients that only read may cost the loop, all of them together."""

    def __init__(self) -> None:
        self.calls = Budget(50.0, 50.0)  # each takes time of a node
        self._lines = Budget(1.0, 10.0)  # the log is recorded
        self._silent = 0

    def log(self, source: Source, text: str) -> None:
        """Log a line about a client, unless there were many; the next one says how many."""
        if not self._lines.take():
            self._silent += 1
            return
        others = f" (and {self._silent} like it)" if self._silent else ""
        self._silent = 0
        source.log(text + others)


class Session:
    """A client.

    Parameters
    ----------
    connection : websockets.asyncio.connection.Connection
        To the client.
    source : Source
        What is shown.
    operates : bool
        Whether the client may operate.
    backlog : int
        Bytes that may wait for it.
    shared : Shared
        What all clients have together.
    """

    def __init__(
        self,
        connection: Connection,
        source: Source,
        operates: bool,
        backlog: int,
        shared: Shared,
    ) -> None:
        self.operates = operates
        host, port, *_ = connection.remote_address or ("?", 0)
        self.peer = f"{host}:{port}"
        self._connection = connection
        self._source = source
        self._backlog = backlog
        self._calls_allowed = Budget(50.0, 50.0) if operates else shared.calls
        self._shared = shared
        self._messages = Budget(200.0, 1000.0)
        self._subscriptions: dict[int, Channel] = {}
        self._watched: set[str] | None = set()  # None: all
        self._tasks: set[asyncio.Task[None]] = set()
        self._dropped = False

    # -- what the server says -----------------------------------------------------------------

    def send(self, message: str | bytes) -> None:
        """Send at once, whether or not the client keeps up."""
        if not self._dropped:
            broadcast((self._connection,), message)

    def say(self, level: int, text: str, identifier: str | None = None) -> None:
        self.send(protocol.status(level, text, identifier))

    def deliver(self, subscription: int, time: int, data: bytes) -> None:
        self.send(protocol.message_data(subscription, time, data))

    async def deliver_slowly(self, subscription: int, time: int, data: bytes) -> None:
        if subscription in self._subscriptions:
            await self._connection.send(protocol.message_data(subscription, time, data))

    def send_services(self, services: Iterable[Service]) -> None:
        """Announce services, as far as the client may call them."""
        allowed = [item for item in services if self.operates or not item.operates]
        if allowed:
            self.send(protocol.advertise_services(allowed))

    def send_parameters(self, values: dict[str, Any]) -> None:
        """Tell of changed parameters, as far as the client wants to know."""
        watched = self._watched
        wanted = {k: v for k, v in values.items() if watched is None or k in watched}
        if wanted:
            self.send(protocol.parameter_values(wanted, None))

    def forget(self, channels: Iterable[int]) -> None:
        """End the subscriptions to channels that have gone."""
        gone = set(channels)
        for number, channel in list(self._subscriptions.items()):
            if channel.number in gone:
                self._unsubscribe(number)

    def check_backlog(self) -> None:
        """Drop the client if it does not keep up."""
        waiting = self._connection.transport.get_write_buffer_size()
        if waiting > self._backlog:
            self.drop(TOO_SLOW, f"too slow: {waiting / 1e6:.1f} MB are waiting")

    def drop(self, code: int, reason: str) -> None:
        """Disconnect the client, with the reason."""
        if self._dropped:
            return
        self._dropped = True
        self._shared.log(self._source, f"dropped: {self.peer}: {reason}")
        self.close()
        transport = self._connection.transport
        asyncio.get_running_loop().call_later(PATIENCE, transport.abort)
        self._start(self._connection.close(code, reason))

    def close(self) -> None:
        """Give up what the client asked for."""
        for number in list(self._subscriptions):
            self._unsubscribe(number)
        for task in self._tasks:
            task.cancel()

    # -- what the client says -----------------------------------------------------------------

    def receive(self, message: str | bytes) -> None:
        """Do what the client asks."""
        if self._dropped:
            return
        if not self._messages.take():
            self.drop(TOO_MANY, "too many messages")
            return
        try:
            self._obey(protocol.parse(message))
        except ProtocolError as error:
            self.say(ERROR, f"not understood: {error}", "protocol")

    def _obey(self, asked: protocol.Request) -> None:
        match asked:
            case protocol.Subscribe(items):
                self._subscribe(items)
            case protocol.Unsubscribe(numbers):
                for number in numbers:
                    self._unsubscribe(number)
            case protocol.GetParameters(names, request):
                known = self._source.parameters
                values = {n: known[n] for n in names if n in known} if names else known
                self.send(protocol.parameter_values(values, request))
            case protocol.WatchParameters(names, wanted):
                self._watch(names, wanted)
            case protocol.SetParameters():
                self._start(self._set_parameters(asked))
            case protocol.Call():
                self._call(asked)
            case protocol.Unsupported(operation):
                self.say(ERROR, f"{operation} is not offered here", "protocol")

    def _subscribe(self, items: Iterable[tuple[int, int]]) -> None:
        wanted: dict[int, Channel] = {}
        for number, channel in items:
            known = self._source.channels.get(channel)
            taken = number in self._subscriptions or len(self._subscriptions) >= protocol.MANY
            if known is None:
                self.say(WARNING, f"there is no channel {channel}")
            elif taken:
                self.say(WARNING, f"subscription {number} is taken, or there are too many")
            else:
                self._subscriptions[number] = wanted[number] = known
        if wanted:
            self._source.subscribe(self, wanted)

    def _unsubscribe(self, number: int) -> None:
        channel = self._subscriptions.pop(number, None)
        if channel is not None:
            self._source.unsubscribe(self, number, channel)

    def _watch(self, names: tuple[str, ...], wanted: bool) -> None:
        if not names:
            self._watched = None if wanted else set()
        elif self._watched is not None:
            self._watched = self._watched | set(names) if wanted else self._watched - set(names)
            self._watched &= self._source.parameters.keys()

    async def _set_parameters(self, asked: protocol.SetParameters) -> None:
        known = self._source.parameters
        try:
            if not self.operates:
                raise Refused(self._refusal("change parameters"))
            await self._source.set_parameters(asked.values, self.peer)
        except Refused as error:
            self.say(ERROR, str(error))
        if asked.request is not None:
            values = {name: known[name] for name in asked.values if name in known}
            self.send(protocol.parameter_values(values, asked.request))

    def _call(self, asked: protocol.Call) -> None:
        service = self._source.services.get(asked.service)
        reason = ""
        if service is None:
            reason = f"there is no service {asked.service}"
        elif service.operates and not self.operates:
            reason = self._refusal(f"call {service.name}")
        elif asked.encoding != protocol.ENCODING:
            reason = f"the encoding must be {protocol.ENCODING}"
        elif len(self._tasks) >= CALLS or not self._calls_allowed.take():
            reason = "too many calls"
        if reason or service is None:
            self.send(protocol.call_failed(asked.service, asked.call, reason))
        else:
            self._start(self._answer(service, asked))

    async def _answer(self, service: Service, asked: protocol.Call) -> None:
        try:
            payload = await self._source.call(service, asked.payload, self.peer)
        except Refused as error:
            self.send(protocol.call_failed(asked.service, asked.call, str(error)))
        else:
            self.send(protocol.answer(asked.service, asked.call, payload))

    def _refusal(self, what: str) -> str:
        reason = f"may only read: to {what} takes the token that 'koop serve --operate' prints"
        self._shared.log(self._source, f"refused: {self.peer} {reason}")
        return reason

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        async def guarded() -> None:
            with suppress(ConnectionClosed):
                await work

        task = asyncio.get_running_loop().create_task(guarded())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
