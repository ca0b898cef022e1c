"""A managed (lifecycle) node that configures and activates itself and reports on /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from koop_node.config import NodeConfig
from koop_node.fields import check_type
from koop_node.parameters import Parameters
from koop_node.report import ERROR, OK, STALE, WARN, Finding, summary
from koop_node.stream import StreamMonitor

# A writer keeps this many samples for a reader that was not scheduled for a while; the oldest are
# lost after that. In lockstep, at 4 kHz, a depth of 100 lost 2 % of a run to a busy machine.
RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)

# Matches any writer: drivers often offer best effort only.
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)

__all__ = ["BEST_EFFORT", "ERROR", "OK", "RELIABLE", "STALE", "WARN", "ManagedNode", "message_type"]


def message_type(name: str) -> Any:
    """Return the class of ``pkg/msg/Type``.

    Raises
    ------
    ValueError
        If no such message is installed.
    """
    package, _, kind = check_type(name).split("/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError):
        raise ValueError(f"message type {name} is not installed") from None


class ManagedNode(LifecycleNode):
    """Base of the nodes: lifecycle, parameters, diagnostics, end of the run.

    A subclass implements :meth:`configure`, :meth:`activate`, :meth:`deactivate` and
    :meth:`cleanup`, which raise ValueError or OSError with a message for the user if they cannot,
    and :meth:`diagnose`. Timers run on the steady clock: simulated time may stand still.
    """

    def __init__(self, name: str, *config_classes: type) -> None:
        super().__init__(name)
        self.exit_code: int | None = None
        self.active = False  # whether the lifecycle state is 'active'; read for every message
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._linking: Any = None
        self._counted = (time.monotonic(), 0)
        self._told = Finding(OK, "")
        self.inputs: tuple[StreamMonitor, ...] = ()  # reported on /diagnostics
        self.parameters = Parameters(
            self, (NodeConfig, *config_classes), self.check_parameters, self.parameters_changed
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.steady_timer(1.0, self._publish_diagnostics)

    # -- for the subclass ---------------------------------------------------------------------

    def configure(self) -> None:
        """Load, allocate, compile, create publishers."""

    def activate(self) -> None:
        """Start working."""

    def deactivate(self) -> None:
        """Stop working; the opposite of :meth:`activate`."""

    def cleanup(self) -> None:
        """Release what :meth:`configure` made."""

    def check_parameters(self, configs: dict[type, Any], names: set[str]) -> None:
        """Raise ValueError to refuse changed configurations; ``names`` were set."""

    def parameters_changed(self, names: set[str]) -> None:
        """Take changed configurations into use."""

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        """Return level, message and values for /diagnostics, besides what the inputs say."""
        return OK, "", {}

    def samples(self) -> int:
        """Return how many samples were processed, for the rate on /diagnostics."""
        return 0

    # -- services of the base class -----------------------------------------------------------

    @property
    def hardware_id(self) -> str:
        """What the diagnostics are about: the loop, for a fleet has one in every namespace."""
        return f"koop{self.get_namespace()}".rstrip("/")

    @property
    def lifecycle_state(self) -> str:
        """Label of the lifecycle state, for example ``active``."""
        return str(self._state_machine.current_state[1])

    def steady_timer(self, period: float, callback: Callable[[], None]) -> Any:
        """Create a timer [s] that runs whatever simulated time does."""
        return self.create_timer(period, callback, clock=self._steady)

    def autostart(self) -> None:
        """Configure and activate if the parameter ``autostart`` says so."""
        if not self.parameters[NodeConfig].autostart:
            return
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                self.finish(1)
                return

    def close(self) -> None:
        """Stop working before the process ends; called once, also after a signal."""
        if self.active:
            self.trigger_deactivate()
        self._deliver_the_last()

    def _deliver_the_last(self) -> None:
        """Wait until what was said is heard: a writer that goes away takes lost samples with it."""
        deadline = time.monotonic() + 0.5
        for publisher in self.publishers:
            left = deadline - time.monotonic()
            if left > 0.0 and publisher.get_subscription_count():
                publisher.wait_for_all_acked(Duration(seconds=left))

    def finish(self, exit_code: int = 0) -> None:
        """End the process after the current callback."""
        self.exit_code = exit_code

    def when_matched(self, needed: Mapping[Publisher, int], then: Callable[[], None]) -> None:
        """Call ``then`` once every publisher has its number of matched subscriptions.

        A reliable writer delivers everything that it wrote after it matched a reader; a node that
        creates its subscription only then tells those upstream that all downstream is ready, and
        no first sample is lost.
        """
        waited = 0

        def look() -> None:
            nonlocal waited
            missing = {
                publisher.topic_name: count - publisher.get_subscription_count()
                for publisher, count in needed.items()
                if publisher.get_subscription_count() < count
            }
            if not missing:
                self.stop_waiting()
                then()
            elif waited % 100 == 20:
                topics = ", ".join(f"{count} on {topic}" for topic, count in missing.items())
                self.get_logger().info(f"waiting for subscribers: {topics}")
            waited += 1

        self.stop_waiting()
        self._linking = self.steady_timer(0.05, look)

    def stop_waiting(self) -> None:
        """End a wait started by :meth:`when_matched`."""
        if self._linking is not None:
            self.destroy_timer(self._linking)
            self._linking = None

    # -- lifecycle transitions ----------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._transition(self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.stop_waiting()
        self.active = False
        return self._transition(self.deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._transition(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if state.label == "active":
            self.on_deactivate(state)
        self.finish(0)
        return TransitionCallbackReturn.SUCCESS

    def _transition(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except (ValueError, OSError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    # -- diagnostics --------------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        level, message, own_values = self.diagnose()
        now, count = time.monotonic(), self.samples()
        before, counted = self._counted
        self._counted = (now, count)
        findings = [Finding(level, message)]
        values: dict[str, object] = {
            "lifecycle_state": self.lifecycle_state,
            "rate_hz": f"{(count - counted) / (now - before):.1f}",
            **own_values,
        }
        for monitor in self.inputs:
            publishers = self.count_publishers(monitor.topic)
            if self.active:
                findings += monitor.findings(now, publishers)
            values |= monitor.values(now, time.time(), publishers)
        told = summary(findings)
        self._log_change(told)
        status = DiagnosticStatus(
            level=bytes([told.level]),
            name=self.get_fully_qualified_name(),
            message=told.text,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _log_change(self, told: Finding) -> None:
        """Log when the level changes: who reads only the log learns it too."""
        if told.level != self._told.level:
            logger = self.get_logger()
            # rclpy ties a severity to the line of the call
            if told.level == OK:
                logger.info(f"all is well again: {told.text}")
            elif told.level == WARN:
                logger.warning(told.text)
            else:
                logger.error(told.text)
        self._told = told
