"""A managed (lifecycle) node that configures and activates itself and reports on /diagnostics."""

from __future__ import annotations

import math
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import import_module
from typing import Any, ClassVar, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

from koop_core.config.fields import Path, check_fields, check_type
from koop_core.config.parameter import ConfigError, NodeConfig
from koop_core.errors import KoopError
from koop_core.kernels import Kernel
from koop_core.port import OTHER
from koop_core.stream.monitor import StreamMonitor
from koop_core.stream.report import ERROR, OK, STALE, WARN, News, NodeFinding, summary
from koop_core.wakeup import never
from koop_node.node import schedule
from koop_node.node.entities import Entities, Input
from koop_node.node.graph import can_say_more, publishers_of, unheard
from koop_node.node.parameters import Parameters
from koop_node.node.rclpy_internals import RefusingLifecycleNode, WithoutEvents
from koop_node.process.housekeeping import release_compiler

__all__ = ["ERROR", "OK", "STALE", "WARN", "Entities", "ManagedNode", "Run", "message_type"]

REPORT_PERIOD = 1.0  # [s]
LOOK_PERIOD = 10.0  # [s] between looks for publishers that cannot be heard, beside others


def message_type(name: str, fields: tuple[Path, ...] = ()) -> Any:
    """Return the class of ``pkg/msg/Type``.

    Raises ConfigError if it is not installed, or has not one of the fields as a number.
    """
    package, _, word = check_type(name).split("/")
    try:
        kind = getattr(import_module(f"{package}.msg"), word)
    except (ImportError, AttributeError):
        raise ConfigError(
            f"message type {name} is not installed: build its package and source it"
        ) from None
    check_fields(fields, kind())
    return kind


class Run:
    """All that a node works with from configure to cleanup, in one object.

    A subclass makes everything in its constructor ``(node, entities)``; what it creates through
    the entities is destroyed with it, also if the constructor fails midway. Constructor and
    :meth:`activate` raise KoopError or OSError with a message for the user if they cannot.
    """

    inputs: tuple[StreamMonitor, ...] = ()
    """Reported on /diagnostics."""
    reader: Input | None = None
    """What compiled code may take messages from."""

    def activate(self, entities: Entities) -> None:
        """Start working; what is created through the entities ends with the active state."""

    def may_end(self, number: int) -> bool:
        """Return whether the process may end now; a signal asked for it. Called until it may."""
        return True

    def deactivate(self) -> None:
        """Stop working, while the entities of the active state are still there."""

    def close(self) -> None:
        """Release what is not an entity."""

    def check_parameters(self, configs: dict[type, Any], names: set[str]) -> None:
        """Raise KoopError to refuse changed configurations; ``names`` were set."""

    def parameters_changed(self, names: set[str]) -> None:
        """Take changed configurations into use."""

    def diagnose(self) -> tuple[int, str, Mapping[str, object]]:
        """Return level, message and values for /diagnostics, besides what the inputs say."""
        return OK, "", {}

    def lend(self, rehearsal: bool) -> tuple[Any, Any] | None:
        """Return what compiled code needs to go on with the node's messages; None: it cannot.

        That is what stays the same, and what changes. Such code takes the messages that follow on
        the last one, each on the one before, and answers them as the node would. For a rehearsal,
        which takes none, the types count.
        """
        return None

    def take_back(self, before: Any, after: Any, now: float) -> None:
        """Take what has changed of what was lent, up to a steady time [s]."""

    def handle(self, reason: int) -> None:
        """Do what compiled code has left to do; see :mod:`koop_core.port` and the node's stage."""
        if reason == OTHER and self.reader is not None:
            self.reader.deliver_last()

    def samples(self) -> int:
        """Return how many samples were processed, for the rate on /diagnostics."""
        return 0


RunT = TypeVar("RunT", bound=Run)


class ManagedNode(WithoutEvents, RefusingLifecycleNode, Generic[RunT]):
    """Base of the nodes: lifecycle, parameters, diagnostics, end of the run.

    ``make_run(node, entities)`` configures; the options are every rclpy node's. ``run`` is
    there from configure to cleanup, the exit code of the process once the node has finished.
    """

    configs: ClassVar[tuple[type, ...]] = ()
    """Configurations of its parameters, besides NodeConfig."""
    stage: ClassVar[Kernel | None] = None
    """Its messages' compiled way; see :mod:`koop_node.node.stages`."""
    due: ClassVar[Kernel] = never
    """When the stage has something to do without a message."""

    def __init__(
        self, name: str, make_run: Callable[[Any, Entities], RunT], **options: Any
    ) -> None:
        super().__init__(name, **options)
        self.exit_code: int | None = None
        self._schedule = schedule.current()
        self.take_back: Callable[[], object] = bool
        """Takes back what compiled code has of the node, before Python has to do with it."""
        self.run: RunT | None = None
        self._make_run = make_run
        self._while_configured: Entities | None = None
        self._while_active: Entities | None = None
        self._counted = (time.monotonic(), 0)
        self._news = News()
        self._known_publishers: dict[str, tuple[list[Any], float]] = {}  # by topic, and when [s]
        global_arguments = sys.argv if options.get("use_global_arguments", True) else []
        self.parameters = Parameters(
            self,
            self.config_classes(),
            lambda configs, names: (self.run or Run()).check_parameters(configs, names),
            lambda names: (self.run or Run()).parameters_changed(names),
            [*global_arguments, *(options.get("cli_args") or ())],
        )
        self._while_there = Entities(self, self._take_back)
        self._diagnostics = self._while_there.publisher(
            DiagnosticArray, "/diagnostics", QoSProfile(depth=10)
        )
        self.reporter = self._while_there.timer(REPORT_PERIOD, self._report)
        if self.parameters[NodeConfig].autostart:
            self._starter = self._while_there.timer(0.0, self._autostart)

    @classmethod
    def config_classes(cls) -> tuple[type, ...]:
        """Return the configurations of all parameters."""
        return (*cls.configs, NodeConfig)

    @property
    def active(self) -> bool:
        """Whether the lifecycle state is 'active'."""
        return self._while_active is not None

    @property
    def lifecycle_state(self) -> str:
        """The primary lifecycle state: ``unconfigured``, ``inactive`` or ``active``."""
        if self.run is None:
            return "unconfigured"
        return "active" if self.active else "inactive"

    def _take_back(self) -> None:
        self.take_back()

    def may_end(self, number: int) -> bool:
        """Return whether the process, which a signal asked to end, may end now."""
        return self.run is None or not self.active or self.run.may_end(number)

    def finish(self, exit_code: int = 0) -> None:
        """End the process after the current callback; in a container, end the work."""
        self.exit_code = exit_code
        if self._schedule is not None:
            self._schedule.ended = True

    def close(self) -> None:
        """Go back to the first state before the process ends; called once, also after a signal."""
        self.take_back()
        if self.active:
            self.trigger_deactivate()
        if self.run is not None:
            self.trigger_cleanup()
        self._while_there.close()

    def _autostart(self) -> None:
        """Do what a lifecycle manager would do."""
        self._starter.cancel()
        for state, transition in (
            ("unconfigured", self.trigger_configure),
            ("inactive", self.trigger_activate),
        ):
            if self.lifecycle_state != state:
                return  # somebody else was faster
            if transition() != TransitionCallbackReturn.SUCCESS:
                self.finish(1)
                return

    # -- lifecycle transitions ----------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        entities = Entities(self, self._take_back)

        def configure() -> None:
            self.run = self._make_run(self, entities)
            self._while_configured = entities
            if self._schedule is not None:  # the process runs such nodes
                release_compiler()

        return self._attempt(configure, entities)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        entities = Entities(self, self._take_back)
        entities.fail = partial(self.finish, 1)

        def activate() -> None:
            assert self.run is not None
            self.run.activate(entities)
            self._while_active = entities

        return self._attempt(activate, entities)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_working()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_working()  # after an error, or told to shut down, a node may be active
        self._release()
        return TransitionCallbackReturn.SUCCESS

    on_error = on_cleanup

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.finish(0)
        return self.on_cleanup(state)

    def _attempt(self, action: Callable[[], None], entities: Entities) -> TransitionCallbackReturn:
        """Make a transition; one that fails midway leaves nothing behind."""
        try:
            action()
        except (KoopError, OSError) as error:
            self.get_logger().error(str(error))
            entities.close()
            return TransitionCallbackReturn.FAILURE
        except Exception:  # a fault of the node's; rclpy would say nothing
            self.get_logger().error(traceback.format_exc())
            entities.close()
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _stop_working(self) -> None:
        entities, self._while_active = self._while_active, None
        if entities is not None:
            try:
                (self.run or Run()).deactivate()
            finally:
                entities.close()

    def _release(self) -> None:
        run, self.run = self.run, None
        entities, self._while_configured = self._while_configured, None
        try:
            if run is not None:
                run.close()
        finally:
            if entities is not None:
                entities.close()

    # -- diagnostics --------------------------------------------------------------------------

    def _report(self) -> None:
        if self.exit_code is not None:  # in a container the process goes on
            if self.active:
                self.trigger_deactivate()
            return
        run = self.run or Run()
        level, message, own_values = run.diagnose()
        now, count = time.monotonic(), run.samples()
        before, counted = self._counted
        self._counted = (now, count)
        findings = [NodeFinding(level, message)]
        values: dict[str, object] = {
            "lifecycle_state": self.lifecycle_state,
            "rate_hz": f"{max(count - counted, 0) / (now - before):.1f}",
            **own_values,
        }
        if self._while_active is not None and self._while_active.waiting_for:
            findings.append(NodeFinding(WARN, self._while_active.waiting_for, at_once=False))
        for monitor in run.inputs:
            publishers = self._publishers_of(monitor, now)
            if self._while_active is not None:
                findings += self._findings(monitor, now, publishers, self._while_active.inputs)
            values |= monitor.values(now, time.time(), len(publishers))
        if self.get_parameter("use_sim_time").value and not self.get_clock().now().nanoseconds:
            findings.append(
                NodeFinding(WARN, "use_sim_time is set, but nothing is published on /clock")
            )
        state = summary(findings)
        self._log(self._news.of(state, now))
        status = DiagnosticStatus(
            level=bytes([state.level]),
            name=self.get_fully_qualified_name(),
            message=state.text,
            hardware_id=f"koop{self.get_namespace()}".rstrip("/"),  # the loop
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _publishers_of(self, monitor: StreamMonitor, now: float) -> list[Any]:
        """Return the publishers of an input: the same, while it hears as many.

        DDS's lists are long where many loops run, and are looked through for each question.
        """
        topic, inputs = monitor.topic, self._while_active.inputs if self._while_active else {}
        known, looked = self._known_publishers.get(topic, ([], -math.inf))
        heard = topic in inputs and monitor.age(now) < REPORT_PERIOD and now - looked < LOOK_PERIOD
        if not (heard and inputs[topic].subscription.get_publisher_count() == len(known)):
            known = publishers_of(self, topic)
            self._known_publishers[topic] = known, now
        return known

    def _findings(
        self, monitor: StreamMonitor, now: float, publishers: list[Any], inputs: dict[str, Input]
    ) -> Iterator[NodeFinding]:
        """Return what is wrong with an input; it then hears all publishers that it can."""
        if monitor.topic not in inputs:  # not before all listen who must
            return iter(())
        inputs[monitor.topic].match(publishers)
        return monitor.findings(
            now,
            len(publishers),
            not monitor.stale(now) or can_say_more(self, publishers),
            unheard(inputs[monitor.topic].subscription, publishers),
        )

    def _log(self, news: NodeFinding | None) -> None:
        if news is None:
            return
        logger = self.get_logger()
        # rclpy ties a severity to the line of the call
        if news.level == OK:
            logger.info(f"recovered: {news.text}")
        elif news.level == WARN:
            logger.warning(news.text)
        else:
            logger.error(news.text)
