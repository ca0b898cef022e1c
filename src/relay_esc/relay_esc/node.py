"""ROS node of the relay extremum-seeking controller: ``cost`` in, ``theta`` out."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from typing import Any

from koop_msgs.msg import ControlInput, Cost
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from koop_node.config import NodeConfig
from koop_node.main import run
from koop_node.managed import OK, RELIABLE, WARN, ManagedNode
from koop_node.stream import LATE, NEXT, REPEAT, StreamMonitor
from relay_esc import relay
from relay_esc.config import EscConfig


class EscNode(ManagedNode):
    """Answers every cost with a control input.

    The control input is held, flagged ``holding``, while the node is inactive, after ``~/hold``,
    and for a cost that is not finite: silence would look like a dead controller. A cost that was
    overtaken by a newer one is counted and not answered.
    """

    def __init__(self) -> None:
        super().__init__("relay_esc", EscConfig)
        self._subscription: Any = None
        self._hold_asked = False

    def configure(self) -> None:
        config = self.parameters[EscConfig]
        self._params, self._largest_change = config.params(), config.largest_change
        self._state = config.initial()
        self._answer = ControlInput(theta=self._state.theta)
        self._input = StreamMonitor("cost", config.cost_timeout, config.dt)
        self.inputs = (self._input,)
        self._origin: tuple[int, str] | None = None
        _compile(config)
        self._publisher = self.create_publisher(ControlInput, "theta", RELIABLE)
        topic = config.command_topic
        self._command = self.create_publisher(Float64, topic, RELIABLE) if topic else None
        self._own_services = [
            self.create_service(Trigger, "~/reset", self._on_reset),
            self.create_service(SetBool, "~/hold", self._on_hold),
        ]

    def activate(self) -> None:
        if self._subscription is None:
            recorders = self.parameters[NodeConfig].recorders
            if self._command is None:
                needed = {self._publisher: 1 + recorders}
            else:  # the rig listens there, and to nothing else
                needed = {self._command: 1, self._publisher: recorders}
            self.when_matched(needed, self._listen)

    def cleanup(self) -> None:
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self._subscription = None
        for service in self._own_services:
            self.destroy_service(service)
        self.destroy_publisher(self._publisher)
        if self._command is not None:
            self.destroy_publisher(self._command)

    def parameters_changed(self, names: set[str]) -> None:
        config = self.parameters[EscConfig]
        self._params, self._largest_change = config.params(), config.largest_change
        if self.inputs:
            self._input.timeout = config.cost_timeout

    def samples(self) -> int:
        return self._input.count if self.inputs else 0

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if not self.inputs or self._input.step is None:
            return OK, "no cost yet", {}
        answer = self._answer
        values = {
            "step": answer.step,
            "theta": answer.theta,
            "epsilon": answer.epsilon,
            "saturated": answer.saturated,
            "holding": answer.holding,
            "model_id": self._origin[1] if self._origin else "",
        }
        return (WARN, "holding theta", values) if answer.holding else (OK, "seeking", values)

    def _listen(self) -> None:
        self._subscription = self.create_subscription(Cost, "cost", self._on_cost, RELIABLE)

    def _on_cost(self, cost: Cost) -> None:
        stamp = cost.header.stamp
        kind = self._input.take(cost.step, stamp.sec + 1e-9 * stamp.nanosec, time.monotonic())
        if kind == LATE:
            return
        if kind != REPEAT:  # else it was asked again: the same answer, no second update
            self._process(cost, kind != NEXT)
        self._publisher.publish(self._answer)
        if self._command is not None:
            self._command.publish(Float64(data=self._answer.theta))

    def _process(self, cost: Cost, from_nothing: bool) -> None:
        origin = (cost.source, cost.model_id)
        if origin != self._origin:  # another quantity: its difference to the last means nothing
            from_nothing = True
            self._origin = origin
        self._state, holding = relay.respond(
            self._params, self._state, cost.r, from_nothing, self._hold_asked or not self.active
        )
        if not math.isfinite(cost.r):
            self._input.reject(f"step {cost.step}: r = {cost.r}")
        state, answer = self._state, self._answer
        answer.header = cost.header
        answer.step = cost.step
        answer.theta = relay.slew(answer.theta, state.theta, self._largest_change)
        answer.epsilon = state.epsilon
        answer.cost_rise_filtered = state.cost_rise_filtered
        answer.saturated = relay.saturated(self._params, answer.theta)
        answer.holding = holding

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
    relay.respond(config.params(), state, 1.0, False, True)
    relay.saturated(config.params(), relay.slew(state.theta, state.theta, math.inf))


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(EscNode))
