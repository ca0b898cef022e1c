"""ROS node of the relay extremum-seeking controller: ``cost`` in, ``theta`` out."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from koop_msgs.msg import ControlInput, Cost
from std_srvs.srv import SetBool, Trigger

from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ListenersConfig
from koop_core.kernels import direct
from koop_core.port import NO_PORT
from koop_core.stream.arrival import LONGEST_DT, SHORTEST_DT, Arrival, timeout_of
from koop_core.stream.monitor import StreamMonitor
from koop_node.node.entities import Writer
from koop_node.node.graph import listeners_of
from koop_node.node.managed import OK, WARN, Entities, ManagedNode, Run
from koop_node.node.qos import RELIABLE
from koop_node.node.stamps import to_seconds
from koop_node.node.wire import codec
from relay_esc import barrier, directions, relay
from relay_esc.config import EscConfig
from relay_esc.level import CostLevel
from relay_esc.stage import COST, THETA, ControllerProgress, ControllerStage, answer_next


class EscRun(Run):
    """A controller from its first cost on."""

    def __init__(self, node: EscNode, entities: Entities) -> None:
        config = node.parameters[EscConfig]
        self._node = node
        self._directions = config.initial_directions()
        self._several = config.count > 1  # knobs
        self._state = self._directions.relay if self._several else config.initial()
        self._answer = codec(ControlInput).new()
        self._answer.theta = self._directions.theta
        self._input = StreamMonitor("cost", timeout_of(LONGEST_DT), LONGEST_DT, may_end=True)
        self._take_parameters()
        self.inputs = (self._input,)
        self._origin: tuple[int, str] | None = None
        self._hold_asked = False
        self._lockstep = self._usable = False  # the last cost
        self._publisher: Writer | None = None
        # for the types that messages bring, and compiled before the first of them
        first_cost = (int(Arrival.RESTART), False, False, 0.0, False, math.nan)
        self._barrier = barrier.UNKNOWN
        if self._several:
            begin = config.initial_directions()  # whose arrays are changed
            self._respond = direct(
                directions.answer, self._params, self._knobs, begin, *first_cost[:-1]
            )
        else:
            self._respond = direct(
                barrier.answer, self._params, self._bound, self._state, self._barrier, *first_cost
            )
        self._insight = direct(relay.insight, self._params, self._state)
        entities.service(Trigger, "~/reset", self._on_reset)
        entities.service(SetBool, "~/hold", self._on_hold)

    def activate(self, entities: Entities) -> None:
        rig, _ = listeners_of(self._node.parameters[ListenersConfig].listeners, "any")
        self._publisher = entities.writer(ControlInput, "theta", RELIABLE)

        def listen() -> None:
            self.reader = entities.reader(Cost, "cost", self._on_cost, RELIABLE)

        entities.when_heard({self._publisher.publisher: rig}, listen)

    def deactivate(self) -> None:
        self._input.pause()
        self._publisher = self.reader = None

    def parameters_changed(self, names: set[str]) -> None:
        self._take_parameters()

    def _take_parameters(self) -> None:
        config, dt = self._node.parameters[EscConfig], self._input.dt
        self._params, self._bound = config.knob(0).params(dt), config.barrier(dt)
        self._knobs = config.knob_limits(dt)
        self._begin_level()

    def _begin_level(self) -> None:
        self._level = CostLevel(self._params.dwell_samples, self._params.sense > 0.0)

    def samples(self) -> int:
        return self._input.count

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if self._input.step is None:
            return OK, "no cost yet", {}
        answer = self._answer
        values = {
            "step": answer.step,
            "theta": format_knobs(answer.theta, ""),
            "epsilon": answer.epsilon,
            "saturated": answer.saturated,
            "holding": answer.holding,
            "swing": answer.swing,
            "gradient": answer.gradient,
            "noise": answer.noise,
            "confidence": answer.confidence,
            "model_id": self._origin[1] if self._origin else "",
            "begin": json.dumps(
                directions.memory(self._directions) if self._several else relay.memory(self._state)
            ),
        }
        if not self._several and relay.outside(self._params, self._state):
            return WARN, "theta is outside its limits", values
        if self._state.since_flip < 0 and answer.holding:
            wait = -self._state.since_flip * self._input.dt
            return WARN, f"joined a run: holding theta, seeking in {wait:.1f} s", values
        if answer.holding:
            return WARN, "holding theta", values
        finding, swing = self._level.finding(), self._state.swing
        if not finding and (opened := max(swing.below, swing.beyond)):
            unit = "Np" if self._params.logarithmic else "theta"
            finding = f"the best may be beyond theta's limits: open by {opened:.3g} [{unit}]"
        return (WARN, finding, values) if finding else (OK, "seeking", values)

    def _on_cost(self, cost: Any, written: float) -> None:
        if cost.dt != self._input.dt:
            self._take_dt(cost)
        arrival = self._input.hear_message(cost, time.monotonic(), written)
        if arrival >= Arrival.LATE or self._publisher is None:
            return
        if arrival is not Arrival.REPEAT:  # else asked again: the same answer, no second update
            self._process(cost, arrival)
        self._publisher.publish(self._answer)

    def _take_dt(self, cost: Any) -> None:
        """Begin again at another sampling time; a cost whose own cannot be used has no r."""
        if not SHORTEST_DT <= cost.dt <= LONGEST_DT:
            cost.r, cost.settling = math.nan, False
            return
        self._input.follow(cost.dt)
        self._take_parameters()
        self._node.get_logger().info(
            f"the costs are {cost.dt:g} s apart", throttle_duration_sec=1.0
        )

    def _process(self, cost: Any, arrival: Arrival) -> None:
        origin, self._lockstep = (cost.source, cost.model_id), cost.lockstep
        switched, self._origin = origin != self._origin, origin
        if switched or arrival in (Arrival.RESTART, Arrival.JOIN):
            self._begin_level()
        answer = self._answer
        message = int(arrival), switched, cost.settling, cost.r, self._hold_asked
        if self._several:
            self._directions, answer.holding, answer.saturated = self._respond(
                self._params, self._knobs, self._directions, *message
            )
            self._state, answer.theta = self._directions.relay, self._directions.theta
        else:
            self._state, self._barrier, answer.holding, answer.saturated = self._respond(
                self._params, self._bound, self._state, self._barrier, *message, cost.margin
            )
            answer.theta = (self._state.output,)
        self._usable = math.isfinite(cost.r) and not cost.settling
        if not (self._usable or cost.settling):
            self._input.reject(f"step {cost.step}: r = {cost.r}, dt = {cost.dt} s")
        if not answer.holding:
            self._level.take(cost.r)
        state = self._state
        answer.header = cost.header
        answer.step = cost.step
        answer.epsilon = state.epsilon
        answer.cost_rise_filtered = state.cost_rise_filtered
        answer.swing = state.swing.factor
        answer.gradient, answer.noise, answer.confidence = self._insight(self._params, state)

    # -- compiled -----------------------------------------------------------------------------

    def lend(self, rehearsal: bool) -> tuple[ControllerStage, ControllerProgress] | None:
        """Return what :func:`relay_esc.stage.answer_next` needs; None where it cannot go on."""
        reader, writer, level = self.reader, self._publisher, self._level
        if self._several:
            return None
        source, model_id = self._origin or (0, "")
        taken = given = NO_PORT
        if reader is not None and writer is not None and self._input.steady and self._usable:
            cost = codec(Cost).new()
            cost.header, cost.model_id = self._answer.header, model_id
            taken, given = reader.port(cost, COST), writer.port(self._answer, THETA)
        elif not rehearsal:
            return None
        stage = ControllerStage(
            taken, given, self._input.dt, source, np.frombuffer(model_id.encode(), np.uint8),
            self._params, self._bound, self._hold_asked, level.window - 1,
            level.floor, self._input.freshness(self._lockstep),
        )  # fmt: skip
        step = self._answer.step
        return stage, ControllerProgress(
            step, self._state, self._barrier, level.sum, level.count, self._input.clocks
        )

    def take_back(self, before: ControllerProgress, after: ControllerProgress, now: float) -> None:
        """Go on where the compiled code ended."""
        if (count := after.step - before.step) and self._publisher is not None:
            self._state, self._barrier = after.relay, after.barrier
            self._answer, self._level.sum = self._publisher.last(), after.level_sum
            self._level.count = after.level_count
            stamp = to_seconds(self._answer.header.stamp)
            self._input.follow_on(count, stamp, now, after.clocks)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        config = self._node.parameters[EscConfig]
        if self._several:
            begin = replace(config, begin=()).initial_directions()
            self._directions = directions.reset(self._knobs, self._directions, begin)
        else:
            self._state = relay.reset(self._state, replace(config, begin=()).initial())
        beginning = format_knobs(knob.beginning for knob in config.knobs())
        response.success = True
        response.message = f"theta is {beginning} again, filter and relay are reset"
        return response

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._hold_asked = request.data
        response.success = True
        held = f"theta held at {format_knobs(self._answer.theta)}"
        response.message = held if request.data else "seeking"
        return response


class EscNode(ManagedNode[EscRun]):
    """Answers every cost with a control input.

    The control input is held, flagged ``holding``, after ``~/hold`` and for a cost that is not
    finite: silence would look like a dead controller. A cost that was overtaken by a newer one, or
    is stale on arrival, is counted and not answered. An inactive controller
    is silent.
    """

    configs = (EscConfig, ListenersConfig)
    stage = answer_next

    def __init__(self, name: str = "relay_esc", **options: Any) -> None:
        super().__init__(name, EscRun, **options)
