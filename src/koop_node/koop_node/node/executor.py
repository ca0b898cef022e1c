"""Calls the callbacks of nodes, woken by the middleware through file descriptors.

A subscription that gets a message has DDS write to a descriptor of its own, a service or a client
to one of its node: libc's ``eventfd_write`` takes the place of a callback, for its arguments are a
descriptor and the number of what is new. The thread of the nodes waits for the descriptors, takes
all that has come, and is not woken for it again; rclpy's EventsExecutor keeps an event for every
message, and takes again.

Timers are of :mod:`koop_node.node.schedule`; there are no waitables in these nodes, see
:class:`koop_node.node.rclpy_internals.WithoutEvents`.
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

import numpy as np
from rclpy.client import Client
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

from koop_core.clock import make_clock
from koop_core.foreign import libc
from koop_core.wakeup import Wakeup

RCLError = rclpy_implementation.RCLError
AT_ONCE = 50  # messages of one entity before others have their turn

Take = Callable[[], bool]
"""Takes one thing that has come to an entity and calls back; returns whether there was one."""


class Executor:
    """Runs the callbacks of some nodes in one thread."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._descriptors: dict[Any, int] = {}  # by subscription or node
        self._entities: dict[Any, tuple[int, Take]] = {}  # descriptor and take
        self._takers: dict[int, list[Take]] = {}  # by descriptor
        self._owners: dict[int, Node] = {}  # by it, too
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
        if timeout < 0.001:  # epoll rounds up to milliseconds
            select.select([self._epoll], [], [], timeout)
            timeout = 0.0
        for descriptor, _ in self._epoll.poll(timeout - 0.001 if timeout else 0.0):
            most = count = os.eventfd_read(descriptor)
            takers = self._takers[descriptor]
            getattr(self._owners[descriptor], "take_back", bool)()
            if count > AT_ONCE or len(takers) > 1:
                most = AT_ONCE
            for take in takers:
                for _ in range(most):
                    if not take():
                        break
                else:
                    if most == AT_ONCE:  # there may be more
                        os.eventfd_write(descriptor, max(count - most, 1))

    def wakeup(self, until: float) -> Wakeup:
        """Return how compiled code waits, at most to a steady time [s]."""
        return Wakeup(
            make_clock(), libc("ppoll"), libc("read"), self._epoll.fileno(), until,
            np.zeros(4, np.int64),
        )  # fmt: skip

    def descriptor(self, subscription: Subscription) -> int:
        """Return where DDS tells that there are messages of a subscription."""
        if self._changed:
            self._follow()
        return self._descriptors[subscription]

    def _follow(self) -> None:
        """Listen to what the nodes have now."""
        self._changed = False
        there = {entity: (node, owner, make) for node, owner, entity, make in self._find()}
        for entity in self._entities.keys() - there.keys():
            descriptor, take = self._entities.pop(entity)
            self._takers[descriptor].remove(take)
            with suppress(InvalidHandle):  # it was destroyed
                _notify(entity, None, None)
        for owner, descriptor in list(self._descriptors.items()):
            if not self._takers[descriptor]:
                del self._descriptors[owner], self._takers[descriptor], self._owners[descriptor]
                self._epoll.unregister(descriptor)
                os.close(descriptor)
        for entity in there.keys() - self._entities.keys():
            node, owner, make = there[entity]
            if owner not in self._descriptors:
                descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
                self._descriptors[owner], self._takers[descriptor] = descriptor, []
                self._owners[descriptor] = node
                self._epoll.register(descriptor, select.EPOLLIN)
            descriptor, take = self._descriptors[owner], make(entity)
            self._entities[entity] = descriptor, take
            self._takers[descriptor].append(take)
            _notify(entity, libc("eventfd_write"), descriptor)

    def _find(self) -> Iterator[tuple[Node, Any, Any, Callable[[Any], Take]]]:
        """Yield each entity with its node, whose descriptor it shares, and what makes its take."""
        for node in self._nodes:
            for subscription in node.subscriptions:
                yield node, subscription, subscription, _take_messages
            for service in node.services:
                yield node, node, service, _take_requests
            for client in node.clients:
                yield node, node, client, _take_responses


def _take_messages(subscription: Any) -> Take:
    handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
    take_message, callback = handle.take_message, subscription.callback
    without_info = subscription._callback_type is Subscription.CallbackType.MessageOnly
    count = 1 if without_info else 2

    def take() -> bool:
        try:
            taken = take_message(kind, raw)
        except RCLError:
            with suppress(InvalidHandle), handle:  # else a callback has destroyed it
                raise
            return False
        if taken is None:
            return False
        callback(*taken[:count])
        return True

    return take


def _take_requests(service: Any) -> Take:
    kind = service.srv_type

    def take() -> bool:
        try:
            with service.handle:
                request, header = service.handle.service_take_request(kind.Request)
        except InvalidHandle:  # a callback has destroyed it
            return False
        if header is None:
            return False
        service.send_response(service.callback(request, kind.Response()), header)
        return True

    return take


def _take_responses(client: Any) -> Take:
    def take() -> bool:
        try:
            with client.handle:
                header, response = client.handle.take_response(client.srv_type.Response)
        except InvalidHandle:
            return False
        if header is None:
            return False
        with suppress(KeyError):  # nobody waits for it any more
            future = client.get_pending_request(header.request_id.sequence_number)
            future.set_result(response)
        return True

    return take


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


def _notify(entity: Any, function: Any, descriptor: int | None) -> None:
    """Have DDS call a function with a descriptor when an entity gets something new; None: no."""
    with entity.handle:
        _setters()[type(entity)](entity.handle.pointer, function, descriptor)
