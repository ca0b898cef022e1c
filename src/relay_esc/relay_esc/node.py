"""ROS node of the relay extremum-seeking controller: ``cost`` in, ``theta`` out."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

from koop_msgs.msg import ControlInput, Cost
from rclpy.publisher import Publisher
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from koop_node.config import NodeConfig
from koop_node.main import run
from koop_node.managed import OK, WARN, Entities, ManagedNode, Run
from koop_node.qos import NEWEST, RELIABLE
from koop_node.stamps import classify
from koop_node.stream import Arrival, StreamMonitor
from relay_esc import relay
from relay_esc.config import EscConfig


class EscRun(Run):
    """A controller from its first cost on."""

    def __init__(self, node: EscNode, entities: Entities) -> None:
        config = node.parameters[EscConfig]
        self._node = node
        self._params, self._largest_change = config.params(), config.largest_change
        self._state = config.initial()
        self._answer = ControlInput(theta=self._state.theta)
        self._input = StreamMonitor("cost", config.cost_timeout, config.dt, may_end=True)
        self.inputs = (self._input,)
        self._origin: tuple[int, str] | None = None
        self._hold_asked = False
        self._publisher: Publisher | None = None
        self._command: Publisher | None = None
        _compile(config)
        entities.service(Trigger, "~/reset", self._on_reset)
        entities.service(SetBool, "~/hold", self._on_hold)

    def activate(self, entities: Entities) -> None:
        recorders = self._node.parameters[NodeConfig].recorders
        topic = self._node.parameters[EscConfig].command_topic
        publisher = self._publisher = entities.publisher(ControlInput, "theta", RELIABLE)
        if topic:  # the rig listens there, and to nothing else
            self._command = entities.publisher(Float64, topic, NEWEST)
            needed = {self._command: 1, publisher: recorders}
        else:
            needed = {publisher: 1 + recorders}
        entities.when_matched(
            needed, lambda: entities.dated_subscription(Cost, "cost", self._on_cost, RELIABLE)
        )

    def deactivate(self) -> None:
        self._publisher = self._command = None

    def parameters_changed(self, names: set[str]) -> None:
        config = self._node.parameters[EscConfig]
        self._params, self._largest_change = config.params(), config.largest_change
        self._input.timeout = config.cost_timeout

    def samples(self) -> int:
        return self._input.count

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if self._input.step is None:
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

    def _on_cost(self, cost: Cost, written: float) -> None:
        kind = classify(self._input, cost, written)
        if kind >= Arrival.LATE or self._publisher is None:
            return
        if kind != Arrival.REPEAT:  # else it was asked again: the same answer, no second update
            self._process(cost, kind != Arrival.NEXT)
        self._publisher.publish(self._answer)
        if self._command is not None:
            self._command.publish(Float64(data=self._answer.theta))

    def _process(self, cost: Cost, from_nothing: bool) -> None:
        origin = (cost.source, cost.model_id)
        if origin != self._origin:  # another quantity: its difference to the last means nothing
            from_nothing = True
            self._origin = origin
        self._state, holding = relay.respond(
            self._params, self._state, cost.r, from_nothing, self._hold_asked
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
        self._state = self._node.parameters[EscConfig].initial()
        response.success = True
        response.message = f"theta is {self._state.theta:g} again, filter and relay are reset"
        return response

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._hold_asked = request.data
        response.success = True
        held = f"theta held at {self._state.theta:g}"
        response.message = held if request.data else "seeking"
        return response


class EscNode(ManagedNode[EscRun]):
    """Answers every cost with a control input.

    The control input is held, flagged ``holding``, after ``~/hold`` and for a cost that is not
    finite: silence would look like a dead controller. A cost that was overtaken by a newer one, or
    is older than ``cost_timeout`` on arrival, is counted and not answered. An inactive controller
    is silent.
    """

    def __init__(self, name: str = "relay_esc", **options: Any) -> None:
        super().__init__(name, EscRun, EscConfig, **options)


def _compile(config: EscConfig) -> None:
    """Compile the kernels for the types that messages bring, before the first sample."""
    state, _ = relay.respond(config.params(), config.initial(), 0.0, True, False)
    relay.respond(config.params(), state, 1.0, False, True)
    relay.saturated(config.params(), relay.slew(state.theta, state.theta, math.inf))


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(EscNode))
