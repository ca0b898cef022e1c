"""ROS node of the relay extremum-seeking controller: ``cost`` in, ``theta`` out."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

from koop_msgs.msg import ControlInput, Cost
from std_srvs.srv import SetBool, Trigger

from koop_node.config import NodeConfig
from koop_node.main import run
from koop_node.managed import OK, QOS, WARN, ManagedNode
from relay_esc import relay
from relay_esc.config import EscConfig


class EscNode(ManagedNode):
    """Answers every cost with a control input.

    The control input is held, flagged ``holding``, while the node is inactive, after ``~/hold``,
    and for a cost that is not finite: silence would look like a dead controller.
    """

    def __init__(self) -> None:
        super().__init__("relay_esc", EscConfig)
        self._subscription: Any = None
        self._hold_asked = False
        self._count = 0
        self._unusable = 0
        self._missed = 0

    def configure(self) -> None:
        config = self.parameters[EscConfig]
        self._params = config.params()
        self._state = config.initial()
        self._answer = ControlInput()
        self._step: int | None = None
        self._origin: tuple[int, str] | None = None
        _compile(config)
        self._publisher = self.create_publisher(ControlInput, "theta", QOS)
        self._own_services = [
            self.create_service(Trigger, "~/reset", self._on_reset),
            self.create_service(SetBool, "~/hold", self._on_hold),
        ]

    def activate(self) -> None:
        if self._subscription is None:
            recorders = self.parameters[NodeConfig].recorders
            self.when_matched({self._publisher: 1 + recorders}, self._listen)

    def cleanup(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self._subscription = None
        for service in self._own_services:
            self.destroy_service(service)
        self.destroy_publisher(self._publisher)

    def parameters_changed(self, names: set[str]) -> None:
        self._params = self.parameters[EscConfig].params()

    def samples(self) -> int:
        return self._count

    def diagnose(self) -> tuple[bytes, str, Mapping[str, object]]:
        if self._step is None:
            return OK, "no cost yet", {}
        answer = self._answer
        level, message = (WARN, "holding theta") if answer.holding else (OK, "seeking")
        values = {
            "step": self._step,
            "theta": answer.theta,
            "saturated": answer.saturated,
            "missed_steps": self._missed,
            "unusable_costs": self._unusable,
        }
        return level, message, values

    def _listen(self) -> None:
        self._subscription = self.create_subscription(Cost, "cost", self._on_cost, QOS)

    def _on_cost(self, cost: Cost) -> None:
        step = cost.step
        if step == self._step:  # asked again: the same answer, no second update
            self._publisher.publish(self._answer)
            return
        anew = False
        if self._step is not None:
            if step < self._step:
                self.get_logger().warning(f"step went back from {self._step} to {step}")
                anew = True
            else:
                self._missed += step - self._step - 1
        origin = (cost.source, cost.model_id)
        if origin != self._origin:
            anew = True
            self._origin = origin
        state, holding = relay.respond(
            self._params, self._state, cost.r, anew, self._hold_asked or not self.active
        )
        self._state, self._step = state, step
        self._count += 1
        self._unusable += not math.isfinite(cost.r)
        answer = self._answer
        answer.header = cost.header
        answer.step = step
        answer.theta = state.theta
        answer.epsilon = state.epsilon
        answer.hp = state.hp
        answer.saturated = relay.saturated(self._params, state.theta)
        answer.holding = holding
        self._publisher.publish(answer)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._state = self.parameters[EscConfig].initial()
        response.success = True
        response.message = f"theta is {self._state.theta:g} again, filter and relay start anew"
        return response

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._hold_asked = request.data
        response.success = True
        held = f"theta held at {self._state.theta:g}"
        response.message = held if request.data else "seeking"
        return response


def _compile(config: EscConfig) -> None:
    """Compile the kernels for the types that messages bring, before the first sample."""
    state, _ = relay.respond(config.params(), config.initial(), 0.0, True, False)
    relay.saturated(config.params(), state.theta)


def main() -> None:
    """Entry point of ``ros2 run relay_esc esc``."""
    sys.exit(run(EscNode))
