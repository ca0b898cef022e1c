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

from koop_core.clock import make_clock
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ListenersConfig
from koop_core.kernels import direct
from koop_core.port import NO_PORT
from koop_core.stream.arrival import Arrival
from koop_core.stream.durations import Durations
from koop_core.stream.monitor import StreamMonitor
from koop_node.node.graph import listeners_of
from koop_node.node.managed import OK, Entities, ManagedNode, Run
from koop_node.node.qos import NEWEST, RELIABLE
from koop_node.node.stamps import to_seconds, to_stamp
from koop_node.node.wire import codec
from vdp_plant import dynamics, pacing
from vdp_plant.config import PaceConfig, PlantConfig
from vdp_plant.stage import GROUND_TRUTH, STATE, THETA, PlantProgress, PlantStage


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
        self._theta_step = self._answered = -1  # whose answer acts, and the latest
        self._due, self.late = math.inf, 0  # of ticks
        x, y = config.initial_state or dynamics.initial_state(config.seed)
        self._x, self._y = float(x), float(y)
        self._simulated_stamp = pace.pace != "realtime"
        self._input = StreamMonitor(
            "theta", pace.theta_timeout, config.dt, newest_counts=self.theta_qos is NEWEST
        )
        self.inputs = (self._input,)
        self._period = pace.period(config.dt)
        self._sent, self._last_sent = np.full(pacing.KEPT, math.nan), -1
        self._round_trip = math.nan
        self._behind, self._round_trips = Durations(), Durations()
        self._clock = make_clock()
        self._compiled = 0  # steps without Python
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
            "compiled_steps": self._compiled,
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
        self._note_sent(k, time.monotonic())
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

    def _note_sent(self, step: int, now: float) -> None:
        self._sent[step % pacing.KEPT], self._last_sent = now, step

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
        self._node.get_logger().info(
            f"done: {self._k} steps, {self._compiled} of them compiled, {self.late} late ticks"
        )
        self._node.finish(0)

    def _usable(self, message: Any) -> bool:
        """Return whether a theta may be applied."""
        step, now = message.step, time.monotonic()
        usable = len(message.theta) == len(self._theta) and all(map(math.isfinite, message.theta))
        if not usable:
            self._input.reject(f"step {step}: theta = {list(message.theta)}")
            return False
        age = pacing.age(self._sent, self._last_sent, self._period, step, now)
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

    # -- compiled -----------------------------------------------------------------------------

    def lend(self, rehearsal: bool) -> tuple[PlantStage, PlantProgress] | None:
        """Return what :func:`vdp_plant.stage.step_next` needs; None where it cannot go on."""
        reader, outlets, pace = self.reader, self._outlets, self._node.parameters[PaceConfig]
        on_clock = self._on_clock_topic and not self._simulated_stamp
        if len(self._theta) > 1 or on_clock or (outlets is not None and outlets.clock is not None):
            return None
        taken = state = truth = NO_PORT
        plain = self.is_plain() and self._node.exit_code is None and self._input.steady
        if reader is not None and outlets is not None and plain:
            theta = codec(ControlInput).new()
            theta.header, theta.theta = self._state_message.header, [0.0]
            taken = reader.port(theta, THETA)
            state = outlets.state.port(self._state_message, STATE)
            truth = outlets.ground_truth.port(self._ground_truth_message, GROUND_TRUTH)
        elif not rehearsal:
            return None
        oldest = pace.theta_timeout or math.inf
        longest = pace.theta_timeout or pace.theta_safe_timeout or math.inf
        stage = PlantStage(
            taken, state, truth, self._params, float(self._steps), self._simulated_stamp,
            self._clock, self._period, self._sent, oldest, longest, self._round_trips.counts,
            self._behind.counts,
        )  # fmt: skip
        return stage, PlantProgress(
            self._k, self._x, self._y, self._theta[0], self._theta_applied[0], self._answered,
            0.0, self._input.heard, self._round_trip, self._theta_step, self._due, self.late,
        )  # fmt: skip

    def is_plain(self) -> bool:
        """Return whether the next message or tick may be as any other."""
        raise NotImplementedError

    def take_back(self, before: PlantProgress, after: PlantProgress, now: float) -> None:
        """Go on where the compiled code ended."""
        if after.k != before.k and self._outlets is not None:
            self._state_message = state = self._outlets.state.last()
            self._ground_truth_message = self._outlets.ground_truth.last()
            self._ground_truth_message.header = state.header
        self._k, self._x, self._y, self._theta[0], self._theta_applied[0] = after[:5]
        self._compiled += after.k - before.k
        self._theta_step, self._due, self.late = after.theta_step, after.due, after.late

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
