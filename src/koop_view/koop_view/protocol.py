"""The Foxglove WebSocket protocol, version 1: what a server reads and writes. Pure.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

from __future__ import annotations

import json
import math
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
    """What a client sent is not a message of the protocol."""


@dataclass(frozen=True)
class Channel:
    """A topic, as it is advertised."""

    number: int
    topic: str
    type_name: str
    definition: str

    def as_json(self) -> dict[str, Any]:
        """Return what the protocol says of it."""
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": ENCODING,
            "schemaName": self.type_name,
            "schema": self.definition,
            "schemaEncoding": SCHEMA_ENCODING,
        }


@dataclass(frozen=True)
class Service:
    """A service, as it is advertised; ``operates`` if it moves or changes the rig."""

    number: int
    name: str
    type_name: str
    request: str
    response: str
    operates: bool

    def as_json(self) -> dict[str, Any]:
        """Return what the protocol says of it, in the words of old clients and of new ones."""
        return {
            "id": self.number,
            "name": self.name,
            "type": self.type_name,
            "requestSchema": self.request,
            "responseSchema": self.response,
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
class SetParameters:
    """Values by name."""

    values: dict[str, Any]
    request: str | None


@dataclass(frozen=True)
class WatchParameters:
    """Names whose changes are wanted, or not any more; none for all."""

    names: tuple[str, ...]
    wanted: bool


@dataclass(frozen=True)
class Call:
    """A call of a service."""

    service: int
    call: int
    encoding: str
    payload: bytes


@dataclass(frozen=True)
class Unsupported:
    """An operation of the protocol that this server does not offer."""

    operation: str


Request = (
    Subscribe | Unsubscribe | GetParameters | SetParameters | WatchParameters | Call | Unsupported
)
_OTHERS = {
    "advertise",
    "unadvertise",
    "subscribeConnectionGraph",
    "unsubscribeConnectionGraph",
    "fetchAsset",
    "playbackControlRequest",
}


def parse(message: str | bytes) -> Request:
    """Return what a client asks.

    Raises
    ------
    ProtocolError
        If the message is none of the protocol.
    """
    return _binary(message) if isinstance(message, bytes) else _text(message)


def _binary(message: bytes) -> Request:
    if message[:1] == b"\x01":
        return Unsupported("publishing")
    if message[:1] != b"\x02" or len(message) < _CALL.size:
        raise ProtocolError(f"a binary message of {len(message)} bytes that is no call")
    _, service, call, length = _CALL.unpack_from(message)
    if length > len(message) - _CALL.size:
        raise ProtocolError("a call that is cut short")
    encoding = message[_CALL.size : _CALL.size + length]
    return Call(
        service, call, encoding[:20].decode("ascii", "replace"), message[_CALL.size + length :]
    )


def _text(message: str) -> Request:
    try:
        given = json.loads(message, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise ProtocolError("not JSON") from None
    if not isinstance(given, dict) or not isinstance(given.get("op"), str):
        raise ProtocolError("not a JSON object with an 'op'")
    operation = given["op"]
    if operation == "subscribe":
        pairs = (_object(item) for item in _list(given, "subscriptions"))
        return Subscribe(
            tuple((_number(pair.get("id")), _number(pair.get("channelId"))) for pair in pairs)
        )
    if operation == "unsubscribe":
        return Unsubscribe(tuple(_number(item) for item in _list(given, "subscriptionIds")))
    if operation == "getParameters":
        return GetParameters(_names(given), _request(given))
    if operation in ("subscribeParameterUpdates", "unsubscribeParameterUpdates"):
        return WatchParameters(_names(given), operation.startswith("subscribe"))
    if operation == "setParameters":
        items = [_object(item) for item in _list(given, "parameters")]
        return SetParameters({_name(i.get("name")): i.get("value") for i in items}, _request(given))
    if operation in _OTHERS:
        return Unsupported(operation)
    raise ProtocolError(f"unknown operation {operation[:40]!r}")


def _refuse(text: str) -> Any:
    raise ValueError(text)


def _list(given: Mapping[str, Any], key: str) -> list[Any]:
    items = given.get(key)
    if not isinstance(items, list) or len(items) > MANY:
        raise ProtocolError(f"'{key}' must be a list of at most {MANY} items")
    return items


def _object(item: Any) -> dict[str, Any]:
    if not isinstance(item, dict):
        raise ProtocolError("a list holds what is not an object")
    return item


def _number(item: Any) -> int:
    if type(item) is not int or not 0 <= item < 2**32:
        raise ProtocolError("an identifier must be a whole number of 32 bits")
    return item


def _name(item: Any) -> str:
    if not isinstance(item, str) or len(item) > LONGEST:
        raise ProtocolError(f"a name must be a text of at most {LONGEST} characters")
    return item


def _names(given: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(_name(item) for item in _list(given, "parameterNames"))


def _request(given: Mapping[str, Any]) -> str | None:
    return _name(given["id"]) if given.get("id") is not None else None


# -- what the server says ---------------------------------------------------------------------


def server_info(
    name: str, capabilities: Iterable[str], metadata: Mapping[str, str], session: str
) -> str:
    """Return the first message to a client."""
    return _said(
        "serverInfo",
        name=name,
        capabilities=list(capabilities),
        supportedEncodings=[ENCODING],
        metadata=dict(metadata),
        sessionId=session,
    )


def status(level: int, text: str, identifier: str | None = None) -> str:
    """Return a message for whoever looks at the client."""
    extra = {} if identifier is None else {"id": identifier}
    return _said("status", level=level, message=text, **extra)


def advertise(channels: Iterable[Channel]) -> str:
    """Return the announcement of channels."""
    return _said("advertise", channels=[channel.as_json() for channel in channels])


def unadvertise(numbers: Iterable[int]) -> str:
    """Return that channels have gone."""
    return _said("unadvertise", channelIds=list(numbers))


def advertise_services(services: Iterable[Service]) -> str:
    """Return the announcement of services."""
    return _said("advertiseServices", services=[service.as_json() for service in services])


def parameter_values(values: Mapping[str, Any], request: str | None) -> str:
    """Return values of parameters."""
    extra = {} if request is None else {"id": request}
    return _said(
        "parameterValues", parameters=[_parameter(*item) for item in values.items()], **extra
    )


def call_failed(service: int, call: int, reason: str) -> str:
    """Return why a call was not made or not answered."""
    return _said("serviceCallFailure", serviceId=service, callId=call, message=reason)


def answer(service: int, call: int, payload: bytes) -> bytes:
    """Return the answer to a call."""
    word = ENCODING.encode()
    return _CALL.pack(3, service, call, len(word)) + word + payload


def message_data(subscription: int, time: int, data: bytes) -> bytes:
    """Return a message of a channel that came at a time [ns]."""
    return _MESSAGE.pack(1, subscription, time) + data


def _said(operation: str, **content: Any) -> str:
    return json.dumps({"op": operation, **content}, separators=(",", ":"), allow_nan=False)


def _parameter(name: str, value: Any) -> dict[str, Any]:
    """Return a parameter; JSON can't tell 1.0 from 1, so a type does. An unset one has no value."""
    result: dict[str, Any] = {"name": name}
    floats = [value] if isinstance(value, float) else value if isinstance(value, list) else []
    if floats and all(isinstance(item, float) for item in floats):
        result["type"] = "float64" if isinstance(value, float) else "float64_array"
        if not all(map(math.isfinite, floats)):  # which JSON cannot say
            value = str(value)
            del result["type"]
    if value is not None:
        result["value"] = value
    return result
