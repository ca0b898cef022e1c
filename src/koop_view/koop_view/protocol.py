"""The Foxglove WebSocket protocol, version 1: what a server reads and writes. Pure.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
INFO, WARNING, ERROR = 0, 1, 2  # levels of a status
MANY = 1000  # items of a list in one message of a client
LONGEST = 300  # characters of a name

_MESSAGE = struct.Struct("<BIQ")  # 1, subscription, time [ns]
_CALL = struct.Struct("<BIII")  # 2 or 3, service, call, length of the encoding's name


class ProtocolError(ValueError):
    """A client's message does not follow the protocol."""


@dataclass(frozen=True)
class AdvertisedChannel:
    """A topic, as it is advertised."""

    number: int
    topic: str
    type_name: str
    definition: str

    def as_json(self) -> dict[str, Any]:
        """Return the channel in the terms of the protocol."""
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": ENCODING,
            "schemaName": self.type_name,
            "schema": self.definition,
            "schemaEncoding": SCHEMA_ENCODING,
        }


@dataclass(frozen=True)
class AdvertisedService:
    """A service, as it is advertised."""

    number: int
    name: str
    type_name: str
    request: str
    response: str

    def as_json(self) -> dict[str, Any]:
        """Return the service in the terms of the protocol."""
        return {
            "id": self.number,
            "name": self.name,
            "type": self.type_name,
            "request": self._side("Request", self.request),
            "response": self._side("Response", self.response),
        }

    def _side(self, side: str, text: str) -> dict[str, str]:
        return {
            "encoding": ENCODING,
            "schemaName": f"{self.type_name}_{side}",
            "schemaEncoding": SCHEMA_ENCODING,
            "schema": text,
        }


@dataclass(frozen=True)
class Subscribe:
    """Subscriptions with their channels."""

    items: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Unsubscribe:
    """Subscriptions that end."""

    numbers: tuple[int, ...]


@dataclass(frozen=True)
class GetParameters:
    """Names, none for all, and an identifier for the answer."""

    names: tuple[str, ...]
    request: str | None


@dataclass(frozen=True)
class WatchParameters:
    """Names whose changes are wanted, or no longer wanted; none for all."""

    names: tuple[str, ...]
    wanted: bool


@dataclass(frozen=True)
class Call:
    """A call of a service."""

    service: int
    call: int
    encoding: str
    payload: bytes


Request = Subscribe | Unsubscribe | GetParameters | WatchParameters | Call


def parse(message: str | bytes) -> Request:
    """Return a client's request.

    Raises
    ------
    ProtocolError
        If the message does not follow the protocol, or asks for what this server does not offer:
        parameters are set by a node's service, which gives a reason if it refuses.
    """
    return _parse_binary(message) if isinstance(message, bytes) else _parse_text(message)


def _parse_binary(message: bytes) -> Request:
    if message[:1] != b"\x02" or len(message) < _CALL.size:
        raise ProtocolError(f"a binary message of {len(message)} bytes that is not a call")
    _, service, call, length = _CALL.unpack_from(message)
    if length > len(message) - _CALL.size:
        raise ProtocolError("a call that is cut short")
    begin = _CALL.size + length
    encoding = message[_CALL.size : begin][:20].decode("ascii", "replace")
    return Call(service, call, encoding, message[begin:])


def _parse_text(message: str) -> Request:
    try:
        content = json.loads(message)
    except (ValueError, RecursionError):
        raise ProtocolError("not JSON") from None
    if not isinstance(content, dict) or not isinstance(content.get("op"), str):
        raise ProtocolError("not a JSON object with an 'op'")
    operation = content["op"]
    if operation == "subscribe":
        pairs = (_object(item) for item in _list(content, "subscriptions"))
        return Subscribe(
            tuple((_number(pair.get("id")), _number(pair.get("channelId"))) for pair in pairs)
        )
    if operation == "unsubscribe":
        return Unsubscribe(tuple(_number(item) for item in _list(content, "subscriptionIds")))
    if operation == "getParameters":
        request = _name(content["id"]) if content.get("id") is not None else None
        return GetParameters(_names(content), request)
    if operation in ("subscribeParameterUpdates", "unsubscribeParameterUpdates"):
        return WatchParameters(_names(content), operation.startswith("subscribe"))
    raise ProtocolError(f"{operation[:40]!r} is not offered here")


def _list(content: Mapping[str, Any], key: str) -> list[Any]:
    items = content.get(key)
    if not isinstance(items, list) or len(items) > MANY:
        raise ProtocolError(f"'{key}' must be a list of at most {MANY} items")
    return items


def _object(item: Any) -> dict[str, Any]:
    if not isinstance(item, dict):
        raise ProtocolError("every item of the list must be an object")
    return item


def _number(item: Any) -> int:
    if type(item) is not int or not 0 <= item < 2**32:
        raise ProtocolError("an identifier must be a whole number of 32 bits")
    return item


def _name(item: Any) -> str:
    if not isinstance(item, str) or len(item) > LONGEST:
        raise ProtocolError(f"a name must be a text of at most {LONGEST} characters")
    return item


def _names(content: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(_name(item) for item in _list(content, "parameterNames"))


# -- messages of the server -------------------------------------------------------------------


def server_info(
    name: str, capabilities: Iterable[str], metadata: Mapping[str, str], session: str
) -> str:
    """Return the first message to a client."""
    return _encode(
        "serverInfo",
        name=name,
        capabilities=list(capabilities),
        supportedEncodings=[ENCODING],
        metadata=dict(metadata),
        sessionId=session,
    )


def status(level: int, text: str) -> str:
    """Return a text for the user of a client."""
    return _encode("status", level=level, message=text)


def advertise(channels: Iterable[AdvertisedChannel]) -> str:
    """Return the announcement of channels."""
    return _encode("advertise", channels=[channel.as_json() for channel in channels])


def advertise_services(services: Iterable[AdvertisedService]) -> str:
    """Return the announcement of services."""
    return _encode("advertiseServices", services=[service.as_json() for service in services])


def parameter_values(values: Mapping[str, Any], request: str | None) -> str:
    """Return values of parameters."""
    extra = {} if request is None else {"id": request}
    parameters = [_parameter(*item) for item in values.items()]
    return _encode("parameterValues", parameters=parameters, **extra)


def call_failed(service: int, call: int, reason: str) -> str:
    """Return why a call was not made or not answered."""
    return _encode("serviceCallFailure", serviceId=service, callId=call, message=reason)


def answer(service: int, call: int, payload: bytes) -> bytes:
    """Return the answer to a call."""
    word = ENCODING.encode()
    return _CALL.pack(3, service, call, len(word)) + word + payload


def message_data(subscription: int, time: int, data: bytes) -> bytes:
    """Return a message of a channel that came at a time [ns]."""
    return _MESSAGE.pack(1, subscription, time) + data


def _encode(operation: str, **content: Any) -> str:
    return json.dumps({"op": operation, **content}, separators=(",", ":"), allow_nan=False)


def _parameter(name: str, value: Any) -> dict[str, Any]:
    """Return a parameter; an unset one has no value, and infinity or a date is a text in JSON."""
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        value = str(value)
    return {"name": name} if value is None else {"name": name, "value": value}
