"""What the nodes need of rclpy's private parts, or otherwise than rclpy does it: each with why."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl import rcutils_logger
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from koop_node.process.joining import joining, leaving

# rclpy tells lines that log from each other by file and number, but has Python look for their text,
# too, in all modules that there are: a tenth of the time that a node takes to start.
rcutils_logger.inspect = SimpleNamespace(  # type: ignore[assignment]
    currentframe=inspect.currentframe, getframeinfo=partial(inspect.getframeinfo, context=0)
)
# Of this package messages need only what loads their type support; it brings its generator of code,
# if that can be imported, with a parser for which it has no use here: 30 ms of every start.
sys.modules.setdefault("rosidl_generator_py.generate_py_impl", None)  # type: ignore[arg-type]


def parameter_overrides(node: Node) -> dict[str, Any]:
    """Return all parameter values given at the start, also those that nobody declared.

    rclpy only offers to declare them all, with types guessed from the values and an event for each.
    """
    return {name: item.value for name, item in node._parameter_overrides.items()}


def announce_parameters(node: Node) -> None:
    """Publish all parameters of a node on /parameter_events, as rclpy does where one is declared.

    That comes before anyone can listen.
    """
    declared: Any = node.get_parameters_by_prefix("")  # Parameters, whatever the annotation says
    node._parameter_event_publisher.publish(
        ParameterEvent(
            stamp=node.get_clock().now().to_msg(),
            node=node.get_fully_qualified_name(),
            new_parameters=[parameter.to_parameter_msg() for parameter in declared.values()],
        )
    )


def parameters_are_heard(node: Node) -> bool:
    """Return whether anyone would hear :func:`announce_parameters`."""
    return bool(node._parameter_event_publisher.get_subscription_count())


def publishers_as_told(node: Node, topic: str) -> list[dict[str, Any]]:
    """Return what the middleware tells of the publishers of a topic, by its full name.

    rclpy makes objects of it, which take several times as long, also where nothing has changed.
    """
    with node.handle:
        told: list[dict[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(
            node.handle, topic, False
        )
    return told


def polled(message: bytes) -> None:
    """Stand in for the callback of a subscription whose messages are taken by polling."""
    raise AssertionError("polled, not executed")


class WithoutEvents(Node):
    """A node without the callbacks for QoS events that rclpy installs by default.

    With its EventsExecutor they can deadlock (rmw_fastrtps 890): the middleware calls them while it
    holds a lock. They would log that somebody offers another type or QoS; ``ros2 topic info -v``
    shows it too. The node joins and leaves its domain as :mod:`koop_node.process.joining` says.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        with joining():
            super().__init__(*args, **options)

    def destroy_node(self) -> None:
        with leaving():
            super().destroy_node()

    @property
    def subscriptions(self) -> Iterator[Any]:
        """The subscriptions that an executor serves, without the polled ones."""
        return (item for item in super().subscriptions if item.callback is not polled)

    def create_publisher(self, *args: Any, **options: Any) -> Publisher:
        options.setdefault("event_callbacks", PublisherEventCallbacks(use_default_callbacks=False))
        return super().create_publisher(*args, **options)

    def create_subscription(self, *args: Any, **options: Any) -> Subscription:
        options.setdefault(
            "event_callbacks", SubscriptionEventCallbacks(use_default_callbacks=False)
        )
        return super().create_subscription(*args, **options)


class RefusingLifecycleNode(LifecycleNode):
    """A node that refuses a transition which its state does not allow.

    rclpy raises in the service's callback, and the node would end, whoever had asked.
    """

    def destroy_node(self) -> None:
        """Leave the domain.

        rclpy leaves the services of the life cycle to the garbage collector, and with them the node
        and its participant: 0.1 s for all that there is.
        """
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def _LifecycleNodeMixin__on_change_state(  # the private name of rclpy's callback
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        state = self._state_machine.current_state[1]
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except _rclpy.RCLError:
            asked = request.transition.label or f"transition {request.transition.id}"
            self.get_logger().error(f"refused: {asked} is not possible while the node is {state}")
            response.success = False
            return response
