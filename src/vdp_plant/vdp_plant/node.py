"""ROS node of the plant: ``theta`` in, ``state`` and ``ground_truth`` out, at three paces."""

from __future__ import annotations

import math
import sys
import time
from array import array
from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
from koop_msgs.msg import ControlInput, Cost, MeasuredState, PlantTruth
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from koop_node.config import NodeConfig
from koop_node.main import run
from koop_node.managed import ERROR, OK, RELIABLE, WARN, ManagedNode
from koop_node.stream import LATE, StreamMonitor
from vdp_plant import dynamics
from vdp_plant.config import RESENDS, PaceConfig, PlantConfig

CHECK_PERIOD = 0.05  # [s] between looks whether the answer in lockstep is overdue
ROUND_TRIPS = 256  # states whose sending time is kept until their theta comes


class PlantNode(ManagedNode):
    """Simulates the plant step by step and publishes its corrupted state."""

    def __init__(self) -> None:
        self._k = 0
        self._late = self._late_told = 0
        super().__init__("vdp_plant", PlantConfig, PaceConfig)

    # -- lifecycle ----------------------------------------------------------------------------

    def configure(self) -> None:
        config, pace = self.parameters[PlantConfig], self.parameters[PaceConfig]
        self._params = config.params()
        self._k = 0
        self._steps = round(pace.duration / config.dt) if pace.duration > 0.0 else math.inf
        self._theta = self._theta_applied = config.theta_initial
        x, y = config.initial_state or dynamics.initial_state(config.seed)
        self._x, self._y = float(x), float(y)
        self._lockstep = pace.pace == "lockstep"
        self._simulated_stamp = pace.pace != "realtime"
        self._period = config.dt / (pace.time_scale if pace.pace == "scaled" else 1.0)
        self._timer: Any = None
        self._asked_again = 0
        self._watchdog = "waiting"
        self._input = StreamMonitor("theta", pace.theta_timeout, config.dt)
        self.inputs = (self._input,)
        self._sent = [math.nan] * ROUND_TRIPS
        self._round_trip = math.nan
        self._cost_seen: int | None = None
        self._cost_probe: Any = None
        self._started = False
        self._compile()
        self._state_message, self._ground_truth_message = MeasuredState(), PlantTruth()
        self._state_publisher = self.create_publisher(MeasuredState, "state", RELIABLE)
        self._ground_truth_publisher = self.create_publisher(PlantTruth, "ground_truth", RELIABLE)
        self._clock_publisher = (
            self.create_publisher(Clock, "/clock", RELIABLE) if pace.publish_clock else None
        )
        callback = self._on_theta_lockstep if self._lockstep else self._on_theta
        self._subscription = self.create_subscription(ControlInput, "theta", callback, RELIABLE)

    def activate(self) -> None:
        recorders = self.parameters[NodeConfig].recorders
        needed = {self._state_publisher: 1 + recorders, self._ground_truth_publisher: recorders}
        self.when_matched(needed, self._start)

    def deactivate(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def cleanup(self) -> None:
        self._end_probe()
        self.destroy_subscription(self._subscription)
        for publisher in (
            self._state_publisher,
            self._ground_truth_publisher,
            self._clock_publisher,
        ):
            if publisher is not None:
                self.destroy_publisher(publisher)

    def parameters_changed(self, names: set[str]) -> None:
        self._params = self.parameters[PlantConfig].params()
        if self.inputs:
            self._input.timeout = self.parameters[PaceConfig].theta_timeout

    def samples(self) -> int:
        return self._k

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        if not (self.active and self._started):
            return OK, "waiting for the loop to connect" if self.active else "", {}
        late, self._late_told = self._late - self._late_told, self._late
        values = {
            "step": self._k,
            "theta": self._theta,
            "theta_applied": self._theta_applied,
            "late_ticks": self._late,
            "round_trip_ms": f"{self._round_trip * 1e3:.2f}",
            "command": self._watchdog,
        }
        if self._asked_again:
            return ERROR, self._silent_node(), values
        if self._watchdog == "safe":
            return WARN, f"theta_safe = {self.parameters[PaceConfig].theta_safe:g} acts", values
        return (WARN, f"{late} late ticks", values) if late else (OK, "running", values)

    # -- both kinds of pace -------------------------------------------------------------------

    def _start(self) -> None:
        self._input.watch_from(time.monotonic())
        if self._lockstep:
            self._timer = self.steady_timer(CHECK_PERIOD, self._check_answer)
            self._answered = time.monotonic()
            if self._started:  # activated again: ask for the theta that is still missing
                self._state_publisher.publish(self._state_message)
            else:
                self._publish()
        else:
            self._due = time.monotonic() + self._period
            self._timer = self.steady_timer(self._period, self._tick)
        self._started = True

    def _publish(self) -> None:
        """Publish x'(t_k) first, for the loop waits for it, then what is only looked at."""
        k, params = self._k, self._params
        x, y = self._x, self._y
        if not (math.isfinite(x) and math.isfinite(y)):
            self.get_logger().error(
                f"the plant diverged at step {k}: use the rk4 integrator or a smaller dt"
            )
            self.finish(1)
            return
        header = Header(stamp=self._stamp(k))
        state = self._state_message
        state.header = header
        state.step = k
        state.x = array("d", dynamics.measure(params, k, x, y))
        self._sent[k % ROUND_TRIPS] = time.monotonic()
        self._state_publisher.publish(state)
        ground_truth = self._ground_truth_message
        ground_truth.header = header
        ground_truth.step = k
        ground_truth.x = array("d", (x, y))
        ground_truth.theta_applied = self._theta_applied
        ground_truth.epsilon0 = dynamics.damping(params, k * params.dt)
        self._ground_truth_publisher.publish(ground_truth)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=_nanoseconds(k * params.dt)))

    def _advance(self, theta: float) -> None:
        theta = dynamics.actuate(self._params, self._theta_applied, theta)
        self._x, self._y = dynamics.step(self._params, self._k, self._x, self._y, theta)
        self._theta_applied = theta
        self._k += 1
        if self._k >= self._steps:
            self._end_of_run()

    def _stamp(self, k: int) -> Time:
        if self._simulated_stamp:
            return _nanoseconds(k * self._params.dt)
        return self.get_clock().now().to_msg()

    def _end_of_run(self) -> None:
        self.deactivate()
        for publisher in (self._state_publisher, self._ground_truth_publisher):
            publisher.wait_for_all_acked(Duration(seconds=1.0))
        self.get_logger().info(f"done: {self._k} steps, {self._late} late ticks")
        self.finish(0)

    # -- realtime and scaled ------------------------------------------------------------------

    def _tick(self) -> None:
        now = time.monotonic()
        # rclpy drops periods that are past; a tick this late has taken the place of several
        late = int((now - self._due) / self._period)
        if late > 0:
            self._late += late
            self._due += late * self._period
        self._due += self._period
        self._publish()
        theta, self._watchdog = self.parameters[PaceConfig].command(
            self._theta, self._input.age(now)
        )
        self._advance(theta)

    def _on_theta(self, message: ControlInput) -> None:
        if self._take(message):
            self._theta = message.theta

    def _take(self, message: ControlInput) -> bool:
        """Return whether a theta may be applied."""
        step, now = message.step, time.monotonic()
        stamp = message.header.stamp
        if not math.isfinite(message.theta):
            self._input.reject(f"step {step}: theta = {message.theta}")
            return False
        if self._input.take(step, stamp.sec + 1e-9 * stamp.nanosec, now) == LATE:
            return False
        self._round_trip = now - self._sent[step % ROUND_TRIPS]
        return True

    # -- lockstep -----------------------------------------------------------------------------

    def _on_theta_lockstep(self, message: ControlInput) -> None:
        if message.step != self._k or not self.active or not self._started:
            return
        if not self._take(message):
            return
        self._theta = message.theta
        self._answered = time.monotonic()
        if self._asked_again:
            self._asked_again = 0
            self._end_probe()
            self.get_logger().info(f"theta for step {self._k} came after all")
        self._advance(self._theta)
        if self.exit_code is None:
            self._publish()

    def _check_answer(self) -> None:
        timeout = self.parameters[PaceConfig].theta_timeout
        if timeout == 0.0 or time.monotonic() - self._answered < timeout:
            return
        if self._asked_again == RESENDS:
            self.get_logger().error(f"no theta for step {self._k}: {self._silent_node()}")
            self.finish(1)
            return
        self._answered = time.monotonic()
        self._asked_again += 1
        if self._cost_probe is None:
            self._cost_probe = self.create_subscription(Cost, "cost", self._on_cost_probe, RELIABLE)
        self.get_logger().warning(
            f"no theta for step {self._k} in {timeout:g} s: sending the state again "
            f"({self._asked_again} of {RESENDS})"
        )
        self._state_publisher.publish(self._state_message)

    def _on_cost_probe(self, cost: Cost) -> None:
        self._cost_seen = cost.step

    def _end_probe(self) -> None:
        if self._cost_probe is not None:
            self.destroy_subscription(self._cost_probe)
            self._cost_probe = None

    def _silent_node(self) -> str:
        """Say which node of the loop does not answer; known after the state was sent again."""
        if self._cost_seen == self._k:
            return "the lifter answers, the controller (relay_esc) is silent on 'theta'"
        if self._state_publisher.get_subscription_count() == 0:
            return "nobody listens to 'state': the lifter (koopman_lifter) is gone"
        return "the lifter (koopman_lifter) is silent on 'cost'"

    def _compile(self) -> None:
        """Compile the kernels before the first step."""
        theta = dynamics.actuate(self._params, self._theta, self._theta)
        x, y = dynamics.step(self._params, 0, self._x, self._y, theta)
        dynamics.measure(self._params, 0, x, y)
        dynamics.damping(self._params, 0.0)


def _nanoseconds(t: float) -> Time:
    sec, nanosec = divmod(round(t * 1e9), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def main() -> None:
    """Run the node until it is told to stop."""
    sys.exit(run(PlantNode))
