"""Calls the callbacks of nodes, woken by the middleware through file descriptors.

A subscription that gets a message has DDS write to a descriptor of its own, a service or a client
to one of its node: libc's ``eventfd_write`` takes the place of a callback, for its arguments are a
descriptor and the number of what is new. The thread of the nodes waits for the descriptors, takes
all that has come, and is not woken for it again; rclpy's EventsExecutor keeps an event for every
message, and takes again.

Timers are of :mod:`koop_node.node.schedule`; there are no waitables in these nodes, see
:class:`koop_node.node.entities.WithoutEvents`.
"""

from __future__ import annotations

import ctypes
import os
import resource
import select
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from typing import Any

from rclpy.client import Client
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

AT_ONCE = 50  # messages of one entity before others have their turn

Take = Callable[[Any], bool]
"""Takes what has come to an entity and calls back; returns whether there was something."""


class Executor:
    """Runs the callbacks of some nodes in one thread."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._descriptors: dict[Any, int] = {}  # by subscription or node
        self._entities: dict[int, dict[Any, Take]] = {}  # by descriptor
        self._epoll = select.epoll()
        self._changed = False
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        with suppress(OSError, ValueError):  # the system may have lowered its own limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a fleet needs thousands

    def add_node(self, node: Node) -> None:
        """Take in a node with all of its entities, also those that it makes later."""
        if node not in self._nodes:
            self._nodes.append(node)
            node.executor = self  # type: ignore[assignment]  # all that rclpy asks of one is here
            self._changed = True

    def remove_node(self, node: Node) -> None:
        """Let go of a node; called before it is destroyed."""
        if node in self._nodes:
            self._nodes.remove(node)
            node.executor = None  # type: ignore[assignment]
            self._follow()

    def wake(self) -> None:
        """Take note that entities were made or destroyed; rclpy calls it."""
        self._changed = True

    def shutdown(self) -> None:
        """Let go of all nodes."""
        for node in list(self._nodes):
            self.remove_node(node)
        self._epoll.close()

    def run(self, timeout: float) -> None:
        """Wait for something new, at most a time [s], and call the callbacks of what there is."""
        if self._changed:
            self._follow()
        select.select([self._epoll], [], [], timeout)  # which does not round to milliseconds
        for descriptor, _ in self._epoll.poll(0):
            os.eventfd_read(descriptor)
            for entity, take in list(self._entities[descriptor].items()):
                for _ in range(AT_ONCE):
                    if not (_is_there(entity) and take(entity)):
                        break
                else:
                    os.eventfd_write(descriptor, 1)

    def _follow(self) -> None:
        """Listen to what the nodes have now."""
        self._changed = False
        there = {entity: (owner, take) for owner, entity, take in self._find()}
        for entities in self._entities.values():
            for entity in entities.keys() - there.keys():
                del entities[entity]
                if _is_there(entity):
                    _notify(entity, None, None)
        for owner, descriptor in list(self._descriptors.items()):
            if not self._entities[descriptor]:
                del self._descriptors[owner], self._entities[descriptor]
                self._epoll.unregister(descriptor)
                os.close(descriptor)
        for entity, (owner, take) in there.items():
            if owner not in self._descriptors:
                descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
                self._descriptors[owner], self._entities[descriptor] = descriptor, {}
                self._epoll.register(descriptor, select.EPOLLIN)
            descriptor = self._descriptors[owner]
            if entity not in self._entities[descriptor]:
                self._entities[descriptor][entity] = take
                _notify(entity, _eventfd_write(), descriptor)

    def _find(self) -> Iterator[tuple[Any, Any, Take]]:
        """Yield each entity with whose descriptor it shares, and what takes from it."""
        for node in self._nodes:
            for subscription in node.subscriptions:
                yield subscription, subscription, _take_message
            for service in node.services:
                yield node, service, _take_request
            for client in node.clients:
                yield node, client, _take_response


def _is_there(entity: Any) -> bool:
    """Return whether an entity was not destroyed, as by another's callback."""
    try:
        with entity.handle:
            return True
    except InvalidHandle:
        return False


def _take_message(subscription: Any) -> bool:
    """Take a message and call back; return whether there was one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return False
    if subscription._callback_type is Subscription.CallbackType.MessageOnly:
        subscription.callback(taken[0])
    else:
        subscription.callback(*taken)
    return True


def _take_request(service: Any) -> bool:
    """Take a request and answer it; return whether there was one."""
    with service.handle:
        request, header = service.handle.service_take_request(service.srv_type.Request)
    if header is None:
        return False
    response = service.callback(request, service.srv_type.Response())
    service.send_response(response, header)
    return True


def _take_response(client: Any) -> bool:
    """Take a response and complete its future; return whether there was one."""
    with client.handle:
        header, response = client.handle.take_response(client.srv_type.Response)
    if header is None:
        return False
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:  # nobody waits for it any more
        return True
    future.set_result(response)
    return True


@cache
def _setters() -> dict[type, Any]:
    rcl = ctypes.CDLL("librcl.so")
    setters = {
        Subscription: rcl.rcl_subscription_set_on_new_message_callback,
        Service: rcl.rcl_service_set_on_new_request_callback,
        Client: rcl.rcl_client_set_on_new_response_callback,
    }
    for function in setters.values():
        function.argtypes = [ctypes.c_void_p] * 3
    return setters


@cache
def _eventfd_write() -> Any:
    return ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)


def _notify(entity: Any, function: Any, descriptor: int | None) -> None:
    """Have DDS call a function with a descriptor when an entity gets something new; None: no."""
    with entity.handle:
        _setters()[type(entity)](entity.handle.pointer, function, descriptor)
