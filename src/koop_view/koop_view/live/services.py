"""Services of the loop's nodes, called with bytes and answered with bytes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from koop_bag.cdr.definition import parse_definition
from koop_bag.cdr.schema import load_service
from koop_bag.errors import BagError
from koop_node.client.question import Question
from koop_view.cdr_check import CdrError, check
from koop_view.protocol import Service
from koop_view.source import Refused

ANSWER = 5.0  # [s] for a node to answer
READS = {
    "rcl_interfaces": (
        "DescribeParameters",
        "GetParameters",
        "GetParameterTypes",
        "ListParameters",
    ),
    "lifecycle_msgs": ("GetState", "GetAvailableStates", "GetAvailableTransitions"),
    "type_description_interfaces": ("GetTypeDescription",),
}
"""Services that change nothing, by package."""
ONCE = {"std_srvs": ("Trigger",), "lifecycle_msgs": ("ChangeState",)}
"""Services that do not bear being called twice."""


def _is_in(type_name: str, table: Mapping[str, tuple[str, ...]]) -> bool:
    package, _, name = type_name.partition("/srv/")
    return name in table.get(package, ())


def load(number: int, name: str, type_name: str) -> Service:
    """Return a service as it is advertised; raise BagError if its type is not installed."""
    service_class(type_name)
    request, response = load_service(type_name)
    return Service(
        number, name, type_name, request.text, response.text, not _is_in(type_name, READS)
    )


def service_class(type_name: str) -> Any:
    """Return the Python class of a service type."""
    package, _, name = type_name.partition("/srv/")
    try:
        return getattr(import_module(f"{package}.srv"), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f"{type_name} has no Python class") from error


def unpacked(service: Service, payload: bytes) -> Any:
    """Return the request that bytes hold; raise Refused if they hold none."""
    package, _, name = service.type_name.partition("/srv/")
    kind = service_class(service.type_name).Request
    if not kind.get_fields_and_field_types():  # some clients send one byte for it, some none
        return kind()
    try:
        check(parse_definition(f"{package}/msg/{name}_Request", service.request), payload)
        return deserialize_message(payload, kind)
    except (CdrError, BagError) as error:
        raise Refused(f"not a request of {service.name}: {error}") from None
    except Exception as error:  # a text that is not UTF-8, a bound; the middleware says it its way
        raise Refused(f"not a request of {service.name}: {type(error).__name__}") from None


class Caller:
    """Calls services from an event loop in which the node's executor is polled.

    Parameters
    ----------
    node : rclpy.node.Node
        Owner of the clients.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, Any] = {}
        self.waiting = 0
        """Calls that wait for their answers."""

    def prepare(self, type_name: str, name: str) -> Any:
        """Return the client of a service. One that is made early has been found by then."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(service_class(type_name), name)
        return self._clients[name]

    async def call(self, type_name: str, name: str, request: Any) -> Any:
        """Return the answer of a service.

        Raises
        ------
        Refused
            If there is none.
        """
        client = self.prepare(type_name, name)
        self.waiting += 1
        try:
            deadline = time.monotonic() + ANSWER
            await _until(
                client.service_is_ready, deadline, f"{name} is not there: nothing was done"
            )
            late = f"{name} did not answer in {ANSWER:g} s: look whether it was done"
            if not _is_in(type_name, ONCE):
                return await _until(Question(client, request).answer, deadline, late)
            future = client.call_async(request)
            await _until(future.done, deadline, late)
            return future.result()
        finally:
            self.waiting -= 1


async def _until(condition: Callable[[], Any], deadline: float, otherwise: str) -> Any:
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise Refused(otherwise)
        await asyncio.sleep(0.005)
    return found


def packed(answer: Any) -> bytes:
    """Return an answer as bytes."""
    return bytes(serialize_message(answer))
