"""Services of the loop's nodes, called with bytes and answered with bytes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool, Trigger

from koop_bag.cdr.definition import parse_definition
from koop_bag.errors import BagError
from koop_core.cdr import CdrError, check_message
from koop_node.client.question import Question
from koop_node.node.received import read_value
from koop_view.protocol import AdvertisedService
from koop_view.session import Refused

ANSWER = 5.0  # [s] for a node to answer
OFFERED = {
    "rcl_interfaces/srv/SetParametersAtomically": SetParametersAtomically,
    "std_srvs/srv/SetBool": SetBool,
    "std_srvs/srv/Trigger": Trigger,
}
"""Types of services with which the page operates a loop."""
ONCE = "std_srvs/srv/Trigger"
"""Type of services that must not be called twice."""


def unpack(service: AdvertisedService, payload: bytes) -> Any:
    """Return the request that bytes hold; raise Refused if they hold none."""
    package, _, name = service.type_name.partition("/srv/")
    kind: Any = OFFERED[service.type_name].Request
    if not kind.get_fields_and_field_types():  # some clients send one byte for it, some none
        return kind()
    try:
        check_message(parse_definition(f"{package}/msg/{name}_Request", service.request), payload)
        return deserialize_message(payload, kind)
    except (CdrError, BagError) as error:
        raise Refused(f"not a request of {service.name}: {error}") from None
    except Exception as error:  # a text that is not UTF-8, a bound; the middleware says it its way
        raise Refused(f"not a request of {service.name}: {type(error).__name__}") from None


class ServiceCaller:
    """Calls services from an event loop in which the node's executor is polled."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, Any] = {}
        self.waiting = 0
        """Calls that wait for their answers."""

    def prepare(self, type_name: str, name: str) -> Any:
        """Return the client of a service; one that is made early is connected when it is needed."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(OFFERED[type_name], name)
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
            missing = f"{name} is not available: nothing was done"
            await _until(client.service_is_ready, deadline, missing)
            late = f"{name} did not answer in {ANSWER:g} s: check whether it was done"
            if type_name != ONCE:
                return await _until(Question(client, request).answer, deadline, late)
            future = client.call_async(request)
            await _until(future.done, deadline, late)
            return future.result()
        finally:
            self.waiting -= 1


async def _until(condition: Callable[[], Any], deadline: float, otherwise: str) -> Any:
    while not (result := condition()):
        if time.monotonic() > deadline:
            raise Refused(otherwise)
        await asyncio.sleep(0.005)
    return result


def describe(message: Any) -> str:
    """Return a request or an answer in a few words."""
    if hasattr(message, "parameters"):
        pairs = [(p.name, read_value(p.value)) for p in message.parameters]
        return ", ".join(f"{name}={value}" for name, value in pairs)
    if hasattr(message, "result"):
        return "done" if message.result.successful else f"refused: {message.result.reason}"
    fields = message.get_fields_and_field_types()
    return ", ".join(f"{name}={getattr(message, name)}" for name in fields)
