"""The private parts of rclpy that the nodes need, each with the reason."""

from __future__ import annotations

from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node


def parameter_overrides(node: Node) -> dict[str, Any]:
    """Return all parameter values given at the start, also those that nobody declared.

    rclpy only offers to declare them all, with types guessed from the values and an event for each.
    """
    return {name: item.value for name, item in node._parameter_overrides.items()}


def publishers_as_told(node: Node, topic: str) -> list[dict[str, Any]]:
    """Return what the middleware tells of the publishers of a topic, by its full name.

    rclpy makes objects of it, which take several times as long, also where nothing has changed.
    """
    with node.handle:
        told: list[dict[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(
            node.handle, topic, False
        )
    return told


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
