"""The loop as real node processes over DDS: start, watch, stop.

rclpy is imported only where it is used, so that the offline commands run without ROS.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from koop_lab.errors import LiveError
from koop_loop.parameters import LoopParameters
from koop_node import parameter_file

EXECUTABLES = {  # in the order of starting: who listens comes before who speaks
    "recorder": ("koop_bag", "recorder"),
    "relay_esc": ("relay_esc", "esc"),
    "koopman_lifter": ("koopman_lifter", "lifter"),
    "vdp_plant": ("vdp_plant", "plant"),
}
START_TIMEOUT = 60.0  # [s] for imports and, the first time, for the compilation of the kernels
STOP_TIMEOUT = 10.0  # [s] after which a node that ignores SIGINT is killed


def executable(package: str, name: str) -> Path:
    """Return the path of a node's executable, found through the ament index as ros2 run does."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        path = Path(get_package_prefix(package)) / "lib" / package / name
    except PackageNotFoundError:
        raise LiveError(f"package {package} is not built: run './koop setup'") from None
    if not path.is_file():
        raise LiveError(f"package {package} has no executable {name}: run './koop setup'")
    return path


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C and its like: who presses it twice would leave the nodes behind, running."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, signal.SIG_IGN) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


class NodeProcess:
    """One node in a process of its own, its output in a log file."""

    def __init__(
        self, node: str, arguments: list[str], log: Path, command: list[str] | None = None
    ) -> None:
        self.node = node
        self.log = log
        self._output = open(log, "ab")  # noqa: SIM115 - closed when the process has ended
        self.process = subprocess.Popen(
            [*(command or [str(executable(*EXECUTABLES[node]))]), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C reaches only the parent, which stops them in order
        )

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self.process.poll()

    @uninterrupted()
    def stop(self) -> int:
        """Ask the process to end, wait, kill it if it does not; return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._output.close()
        return self.process.returncode

    def last_lines(self, count: int = 5) -> str:
        """Return the end of the node's output."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-count:])


@dataclass
class Progress:
    """What /diagnostics last said about the loop."""

    step: int = 0
    steps_per_second: float = math.nan
    theta: float = math.nan
    r: float = math.nan
    values: dict[str, dict[str, str]] = field(default_factory=dict)


class Monitor:
    """Listens to /diagnostics only: watching must not cost the loop any speed."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.experimental.events_executor import EventsExecutor

        from koop_node.entities import WithoutEvents

        self.progress = Progress()
        self.levels: dict[str, int] = {}  # that every node last reported
        self._clients: dict[str, Any] = {}
        self._context = rclpy.Context()
        self._context.init(args=[])
        self._node = WithoutEvents("koop_monitor", context=self._context)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 20)
        self._executor: Any = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def spin(self, seconds: float) -> None:
        """Process what arrives within a time."""
        self._executor.spin_once(timeout_sec=seconds)

    def other_loops(self) -> int:
        """Return how many publishers of ``state`` are on this domain."""
        return self.count_publishers("state")

    def count_publishers(self, topic: str) -> int:
        """Return how many publishers of a topic are on this domain."""
        return int(self._node.count_publishers(topic))

    @property
    def theta(self) -> float:
        """Last theta of the controller."""
        return float(self.progress.values.get("relay_esc", {}).get("theta", math.nan))

    def call(self, service_type: Any, name: str, request: Any, wait: float = 5.0) -> Any:
        """Call a service and return its response.

        Raises
        ------
        LiveError
            If nobody answers.
        """
        if name not in self._clients:
            self._clients[name] = self._node.create_client(service_type, name)
        client = self._clients[name]
        deadline = time.monotonic() + wait
        while not client.service_is_ready() and time.monotonic() < deadline:
            self.spin(0.02)
        future = client.call_async(request)
        while not future.done() and time.monotonic() < deadline:
            self.spin(0.02)
        if not future.done():
            raise LiveError(f"no answer from {name} in {wait:g} s")
        return future.result()

    def change_state(self, node: str, transition: str, wait: float = 5.0) -> None:
        """Make a node ``configure``, ``activate``, ``deactivate`` or ``cleanup``.

        Raises
        ------
        LiveError
            If the node refuses or doesn't answer.
        """
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        request = ChangeState.Request()
        request.transition.id = getattr(Transition, f"TRANSITION_{transition.upper()}")
        if not self.call(ChangeState, f"/{node}/change_state", request, wait).success:
            raise LiveError(f"{node} cannot {transition}")

    def set_parameters(self, node: str, values: Mapping[str, str | float]) -> None:
        """Change parameters of a node while it runs.

        Raises
        ------
        LiveError
            If the node refuses or doesn't answer.
        """
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        asked = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        request = SetParametersAtomically.Request(parameters=asked)
        service = f"/{node}/set_parameters_atomically"
        result = self.call(SetParametersAtomically, service, request).result
        if not result.successful:
            raise LiveError(f"{node} refuses: {result.reason}")

    @contextmanager
    def newest_theta(self) -> Iterator[Callable[[], float]]:
        """Subscribe to ``theta``; the function given returns its newest value, at first NaN."""
        from koop_msgs.msg import ControlInput

        newest = math.nan

        def take(message: ControlInput) -> None:
            nonlocal newest
            newest = message.theta

        subscription = self._node.create_subscription(ControlInput, "theta", take, 1)
        try:
            yield lambda: newest
        finally:
            self._node.destroy_subscription(subscription)

    def answer_states(self, theta: Callable[[int], float]) -> None:
        """Answer every ``state`` with ``theta(step)``, in the place of a controller."""
        from koop_msgs.msg import ControlInput, MeasuredState

        from koop_node.qos import RELIABLE

        publisher = self._node.create_publisher(ControlInput, "theta", RELIABLE)

        def answer(state: MeasuredState) -> None:
            publisher.publish(
                ControlInput(header=state.header, step=state.step, theta=theta(state.step))
            )

        self._node.create_subscription(MeasuredState, "state", answer, RELIABLE)

    def close(self) -> None:
        """Leave the DDS domain."""
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    def _on_message(self, message: Any) -> None:
        for status in message.status:
            node = status.name.split(":")[0].strip("/").rsplit("/", 1)[-1]
            values = {item.key: item.value for item in status.values}
            self.progress.values[node] = values
            self.levels[node] = status.level[0]
            if node == "vdp_plant":
                self.progress.step = int(values.get("step", self.progress.step))
                self.progress.steps_per_second = float(values["rate_hz"])
                self.progress.theta = float(values.get("theta", self.progress.theta))
            elif node == "koopman_lifter":
                self.progress.r = float(values.get("r", self.progress.r))


class LiveLoop:
    """The node processes of one run; a context manager that leaves no process behind."""

    def __init__(self, folder: Path, parameters: LoopParameters, record: bool = True) -> None:
        self.folder = folder
        self.bag = folder / "bag"
        self._parameters = parameters
        self._record = record
        self._nodes: dict[str, NodeProcess] = {}

    def __enter__(self) -> LiveLoop:
        logs = self.folder / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        given = self._parameters.as_ros()
        for values in given.values():
            values["recorders"] = int(self._record)
        file = logs / "given_parameters.yaml"
        parameter_file.write(given, file)
        arguments = ["--ros-args", "--params-file", str(file)]
        try:
            for node in EXECUTABLES:
                if node == "recorder":
                    if self._record:
                        self._start(node, ["--ros-args", "-p", f"output:={self.folder}"])
                else:
                    self._start(node, arguments)
        except BaseException:
            self._stop_all()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop_all()

    def _start(self, node: str, arguments: list[str]) -> None:
        self._nodes[node] = NodeProcess(node, arguments, self.folder / "logs" / f"{node}.log")

    @uninterrupted()
    def _stop_all(self) -> dict[str, int]:
        """Stop the sources before the recorder, so that it records all that they said."""
        return {node: process.stop() for node, process in reversed(self._nodes.items())}

    def run(self, on_progress: Callable[[Progress], None]) -> None:
        """Wait until the plant has done its steps, then stop the other nodes.

        Raises
        ------
        LiveError
            If a node ends before its time or with an exit code other than 0.
        """
        monitor = Monitor()
        started = time.monotonic()
        try:
            while (code := self._nodes["vdp_plant"].poll()) is None:
                monitor.spin(0.2)
                on_progress(monitor.progress)
                if monitor.other_loops() > 1:
                    domain = os.environ.get("ROS_DOMAIN_ID", "0")
                    raise LiveError(
                        "another loop runs on this ROS domain; "
                        f"set ROS_DOMAIN_ID (now {domain}) to a free one"
                    )
                for node, process in self._nodes.items():
                    if node != "vdp_plant" and process.poll() is not None:
                        raise self._failure(node, process.poll())
                if monitor.progress.step == 0 and time.monotonic() - started > START_TIMEOUT:
                    raise LiveError(
                        f"the loop did not start in {START_TIMEOUT:g} s: see {self.folder}/logs"
                    )
        finally:
            monitor.close()
        if code != 0:
            raise self._failure("vdp_plant", code)
        for node, exit_code in self._stop_all().items():
            if exit_code != 0:
                raise self._failure(node, exit_code)

    def _failure(self, node: str, code: int | None) -> LiveError:
        process = self._nodes[node]
        return LiveError(
            f"{node} ended with exit code {code}:\n{process.last_lines()}\n({process.log})"
        )
