"""Calls the callbacks of nodes, woken by the middleware through file descriptors.

A subscription, service or client that gets something new has DDS write to a descriptor of its own
(libc's ``eventfd_write`` takes the place of a callback: its arguments are a descriptor and the
number of what is new), on which the thread of the nodes waits. It takes all that has come, and is
not woken for it again; rclpy's EventsExecutor keeps an event for every message, and takes again.

Timers are of :mod:`koop_node.node.schedule`; there are no waitables in these nodes, see
:class:`koop_node.node.entities.WithoutEvents`.
"""

from __future__ import annotations

import ctypes
import os
import select
from collections.abc import Callable
from functools import cache, partial
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

AT_ONCE = 50  # messages of one entity before others have their turn


class Executor:
    """Runs the callbacks of some nodes in one thread."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._entities: dict[Any, int] = {}  # their descriptors
        self._handlers: dict[int, Callable[[], bool]] = {}
        self._epoll = select.epoll()
        self._changed = False

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
            handler = self._handlers.get(descriptor)
            if handler is None:  # another callback has destroyed it
                continue
            os.eventfd_read(descriptor)
            for _ in range(AT_ONCE):
                if not handler():
                    break
            else:
                os.eventfd_write(descriptor, 1)

    def _follow(self) -> None:
        """Listen to what the nodes have now."""
        self._changed = False
        there: dict[Any, Callable[[Any], bool]] = {
            entity: kind
            for node in self._nodes
            for kind, entities in (
                (_take_message, node.subscriptions),
                (_take_request, node.services),
                (_take_response, node.clients),
            )
            for entity in entities
        }
        for entity in self._entities.keys() - there.keys():
            descriptor = self._entities.pop(entity)
            del self._handlers[descriptor]
            _notify(entity, None)
            self._epoll.unregister(descriptor)
            os.close(descriptor)
        for entity in there.keys() - self._entities.keys():
            descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            self._entities[entity] = descriptor
            self._handlers[descriptor] = partial(there[entity], entity)
            self._epoll.register(descriptor, select.EPOLLIN)
            _notify(entity, descriptor)


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


def _notify(entity: Any, descriptor: int | None) -> None:
    """Have DDS write to a descriptor when an entity gets something new; None: no more."""
    function = None
    if descriptor is not None:
        function = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
    try:
        with entity.handle:
            _setters()[type(entity)](entity.handle.pointer, function, descriptor)
    except Exception:  # destroyed already
        if descriptor is not None:
            raise
