"""A plant step by step: what the paces share."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from koop_msgs.msg import ControlInput, MeasuredState, PlantTruth
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ListenersConfig
from koop_core.kernels import direct
from koop_core.stream.arrival import Arrival
from koop_core.stream.monitor import StreamMonitor
from koop_node.node.graph import listeners_of
from koop_node.node.managed import OK, Entities, ManagedNode, Run
from koop_node.node.qos import NEWEST, RELIABLE
from koop_node.node.stamps import to_seconds, to_stamp
from koop_node.node.wire import codec
from vdp_plant import dynamics
from vdp_plant.config import PaceConfig, PlantConfig
from vdp_plant.pacing import SentStates


class Outlets:
    """Publishers of an active plant."""

    def __init__(self, entities: Entities, publish_clock: bool) -> None:
        self.state = entities.writer(MeasuredState, "state", RELIABLE)
        self.ground_truth = entities.writer(PlantTruth, "ground_truth", RELIABLE)
        self.clock: Publisher | None = (
            entities.publisher(Clock, "/clock", RELIABLE) if publish_clock else None
        )

    def acknowledged(self, patience: float) -> bool:
        """Return whether every subscriber has all that was sent, or has within a time [s] each."""
        return all([w.acknowledged(patience) for w in (self.state, self.ground_truth)])


class PlantRun(Run):
    """A plant from its first step on; the pace is the subclass's."""

    theta_qos = RELIABLE
    theta_ages = False
    """Whether a theta is refused that answers a state older than ``theta_timeout``."""

    def __init__(self, node: ManagedNode[PlantRun]) -> None:
        config, pace = node.parameters[PlantConfig], node.parameters[PaceConfig]
        self._node = node
        self._params, self._knobs = config.params(), config.knob_params()
        self._k = 0
        self._steps = round(pace.duration / config.dt) if pace.duration > 0.0 else math.inf
        initial = [knob.theta_initial for knob in config.knobs(coupling=())]
        self._theta, self._theta_applied = array("d", initial), array("d", initial)
        self._theta_step = -1  # whose answer acts
        x, y = config.initial_state or dynamics.initial_state(config.seed)
        self._x, self._y = float(x), float(y)
        self._simulated_stamp = pace.pace != "realtime"
        self._input = StreamMonitor(
            "theta", pace.theta_timeout, config.dt, newest_counts=self.theta_qos is NEWEST
        )
        self.inputs = (self._input,)
        self._sent = SentStates(pace.period(config.dt))
        self._round_trip = math.nan
        self._state_message = codec(MeasuredState).new()
        self._ground_truth_message = codec(PlantTruth).new()
        self._ground_truth_message.header = self._state_message.header
        self._outlets: Outlets | None = None
        """There while the node is active."""
        self._on_clock_topic = bool(node.get_parameter("use_sim_time").value)
        self._compile()

    def activate(self, entities: Entities) -> None:
        outlets = Outlets(entities, self._node.parameters[PaceConfig].publish_clock)
        follower, observers = listeners_of(self._node.parameters[ListenersConfig].listeners, "loop")
        needed = {outlets.state.publisher: follower, outlets.ground_truth.publisher: observers}

        def start() -> None:
            self._input.watch_from(time.monotonic())
            self.start(entities)

        self._outlets = outlets
        self.reader = entities.reader(ControlInput, "theta", self.on_theta, self.theta_qos)
        entities.when_heard(needed, start)

    def deactivate(self) -> None:
        self._outlets = self.reader = None

    def start(self, entities: Entities) -> None:
        """Begin, or go on after a pause: all listeners are there."""
        raise NotImplementedError

    def on_theta(self, message: Any, written: float) -> None:
        """Take a control input."""
        raise NotImplementedError

    def describe_steps(self) -> str:
        """Return what is said of the steps at the end."""
        raise NotImplementedError

    def condition(self) -> tuple[int, str, Mapping[str, object]]:
        """Return level, message and values of this pace for /diagnostics."""
        raise NotImplementedError

    def parameters_changed(self, names: set[str]) -> None:
        config = self._node.parameters[PlantConfig]
        self._params, self._knobs = config.params(), config.knob_params()
        self._input.timeout = self._node.parameters[PaceConfig].theta_timeout

    def samples(self) -> int:
        return self._k

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if self._outlets is None:
            return OK, "", {}
        level, text, values = self.condition()
        return level, text, {
            "step": self._k,
            "theta": format_knobs(self._theta, ""),
            "theta_applied": format_knobs(self._theta_applied, ""),
            "round_trip_ms": f"{self._round_trip * 1e3:.2f}",
            **values,
        }  # fmt: skip

    def _publish(self) -> None:
        """Publish x'(t_k) first, for the loop waits for it, then what is only looked at."""
        k, params, outlets = self._k, self._params, self._outlets
        x, y = self._x, self._y
        if outlets is None:
            return
        if not (math.isfinite(x) and math.isfinite(y)):
            self._node.get_logger().error(f"the plant diverged at step {k}: use a smaller dt")
            self._node.finish(1)
            return
        state = self._state_message
        stamp = state.header.stamp
        stamp.sec, stamp.nanosec = divmod(self._time(k), 1_000_000_000)
        state.step = k
        state.x = self._measure(params, k, x, y)
        self._sent.send(k, time.monotonic())
        outlets.state.publish(state)
        ground_truth = self._ground_truth_message
        ground_truth.step = k
        ground_truth.x = (x, y)
        ground_truth.theta_applied = self._theta_applied
        ground_truth.theta_step = self._theta_step
        ground_truth.epsilon0 = self._damping(params, k * params.dt)
        outlets.ground_truth.publish(ground_truth)
        if outlets.clock is not None:
            outlets.clock.publish(Clock(clock=to_stamp(round(k * params.dt * 1e9))))

    def _advance(self, theta: array[float], theta_step: int) -> None:
        applied = self._theta_applied
        if len(applied) == 1:
            self._x, self._y, applied[0] = self._step(
                self._params, self._k, self._x, self._y, applied[0], theta[0]
            )
        else:
            self._x, self._y = self._step_knobs(
                self._params, self._knobs, self._k, self._x, self._y,
                np.frombuffer(applied), np.frombuffer(theta),
            )  # fmt: skip
        self._theta_step = theta_step
        self._k += 1
        if self._k >= self._steps:
            self._end()

    def _time(self, k: int) -> int:
        """Return the time [ns] that stands in the stamp of a step."""
        if self._simulated_stamp:
            return round(k * self._params.dt * 1e9)
        if self._on_clock_topic:
            return int(self._node.get_clock().now().nanoseconds)
        return time.time_ns()  # the same time, in a hundredth of rclpy's

    def _end(self) -> None:
        assert self._outlets is not None
        self._outlets.acknowledged(1.0)
        self._node.get_logger().info(f"done: {self._k} steps, {self.describe_steps()}")
        self._node.finish(0)

    def _usable(self, message: Any) -> bool:
        """Return whether a theta may be applied."""
        step, now = message.step, time.monotonic()
        usable = len(message.theta) == len(self._theta) and all(map(math.isfinite, message.theta))
        if not usable:
            self._input.reject(f"step {step}: theta = {list(message.theta)}")
            return False
        age = self._sent.age(step, now)
        if math.isnan(age):
            self._input.reject(f"step {step}: this run has published no such state")
            return False
        if self.theta_ages and 0.0 < self._input.timeout < age:
            self._input.too_old += 1
            return False
        if self._input.hear(step, to_seconds(message.header.stamp), now) == Arrival.LATE:
            return False
        self._round_trip = age
        return True

    def _compile(self) -> None:
        """Get the kernels before the first step."""
        x, y, theta = self._x, self._y, np.array(self._theta)
        self._step = direct(dynamics.advance, self._params, 0, x, y, theta[0], theta[0])
        if theta.size > 1:
            self._step_knobs = direct(
                dynamics.advance_knobs, self._params, self._knobs, 0, x, y, theta, theta.copy()
            )
        self._measure = direct(dynamics.measure, self._params, 0, x, y)
        self._damping = direct(dynamics.damping, self._params, 0.0)
