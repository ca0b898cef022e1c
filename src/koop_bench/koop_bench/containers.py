"""Simulated loops in namespaces of one ROS domain, several to a container."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from koop_bench.figures import processor_time, processors
from koop_bench.fleet_report import FleetReport, Snapshot, report, snapshot
from koop_bringup.live.process import START_TIMEOUT, NodeProcess, uninterrupted
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_loop.parameters import COMPONENTS, make
from koop_node.client.alone import alone
from koop_node.client.client import Client

SETTLED = 2.0  # [s] after the last loop has begun
DT = 0.005  # [s] of a step, simulated


class Fleet:
    """The containers of a fleet; a context manager that leaves none behind.

    Loop k is in the namespace ``/loopk`` and in container k modulo their number.

    Parameters
    ----------
    folder : Path
        Receives logs and parameters.
    loops : int
        Number of loops.
    values : mapping of str to mapping
        Parameters of the nodes by name, the same for all loops.
    containers : int
        Processes; by default one a processor that this process may use, and no more than loops.
    """

    def __init__(
        self,
        folder: Path,
        loops: int,
        values: Mapping[str, Mapping[str, Any]],
        containers: int = 0,
    ) -> None:
        self.folder = folder
        self.namespaces = [f"/loop{number}" for number in range(loops)]
        self._values = values
        self._containers = min(containers or len(processors()), loops)
        self.processes: list[NodeProcess] = []
        self._stack = ExitStack()

    def __enter__(self) -> Fleet:
        with ExitStack() as stack:
            stack.enter_context(alone("/loop0"))
            self.folder.mkdir(parents=True, exist_ok=True)
            file = self.folder / "given_parameters.yaml"
            parameter_file.write({name: self._values.get(name, {}) for name in COMPONENTS}, file)
            stack.callback(self.stop)
            for number in range(self._containers):
                words = [
                    f"{component}@{namespace}"
                    for namespace in self.namespaces[number :: self._containers]
                    for component in COMPONENTS.values()
                ]
                words += ["--ros-args", "--params-file", str(file)]
                log = self.folder / f"container{number}.log"
                self.processes.append(NodeProcess("container", words, log))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    @uninterrupted()
    def stop(self) -> None:
        """End the containers, all at once."""
        for process in self.processes:
            process.ask_to_stop()
        for process in self.processes:
            process.stop()

    def check(self) -> None:
        """Raise LiveError if a container has ended."""
        for process in self.processes:
            if process.poll() is not None:
                raise process.failure()

    def processor_time(self) -> float:
        """Return the processor time that all containers have used [s]."""
        return sum(processor_time(process.process.pid) for process in self.processes)


class FleetMonitor(Client):
    """Last reports of the nodes of all loops on /diagnostics.

    Attributes
    ----------
    values : dict
        By the node's full name, such as ``/loop0/vdp_plant``.
    times : dict
        Of the reports, by the nodes' own clocks [s].
    """

    def __init__(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        super().__init__("koop_fleet")
        self.values: dict[str, dict[str, str]] = {}
        self.times: dict[str, float] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 1000)

    def listen(self, seconds: float, check: Callable[[], object]) -> None:
        """Listen for a time; ``check`` is called meanwhile and may raise."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin(0.2)
            check()

    def snapshots(self, fleet: Fleet) -> list[Snapshot]:
        """Return the last report of each loop."""
        return [snapshot(name, self.values, self.times) for name in fleet.namespaces]

    def wait_until_running(self, fleet: Fleet, steps: int = 1) -> None:
        """Wait until every plant of a fleet has done so many steps.

        Raises
        ------
        LiveError
            If one does not begin, or a container ends.
        """
        waiting = {f"{namespace}/vdp_plant" for namespace in fleet.namespaces}
        seconds = START_TIMEOUT + 0.5 * len(waiting)

        def ready() -> bool:
            begun = {n for n in waiting if int(self.values.get(n, {}).get("step", 0)) >= steps}
            waiting.difference_update(begun)
            return not waiting

        try:
            self.wait_for(ready, seconds, "all loops", fleet.check)
        except LiveError as error:
            names = ", ".join(sorted(waiting))
            raise LiveError(f"{error}: {names} did not begin; see {fleet.folder}") from None

    def _on_message(self, message: Any) -> None:
        stamp = message.header.stamp
        for status in message.status:
            name = status.name.split(":")[0]
            self.values[name] = {item.key: item.value for item in status.values}
            self.times[name] = stamp.sec + 1e-9 * stamp.nanosec


def parameters_at(rate: float, priority: int = 0) -> dict[str, dict[str, Any]]:
    """Return the nodes' parameters for a rate [Hz]; with a real-time priority, locked in memory."""
    pace: dict[str, Any] = {"pace": "realtime"}
    if abs(rate * DT - 1.0) > 1e-9:
        pace = {"pace": "scaled", "time_scale": rate * DT}
    values: dict[str, dict[str, Any]] = {name: {"priority": priority} for name in COMPONENTS}
    values["vdp_plant"] |= {**pace, "duration": 0.0}
    make(values)
    return values


def measure_fleet(
    loops: int, rate: float, duration: float, priority: int = 0, containers: int = 0
) -> FleetReport:
    """Run a fleet at a rate [Hz]; return its report over a time [s] once all loops had settled.

    Raises
    ------
    koop_core.errors.LiveError
        If a container ends, or a loop does not begin.
    """
    values = parameters_at(rate, priority)
    with (
        tempfile.TemporaryDirectory() as folder,
        Fleet(Path(folder), loops, values, containers) as fleet,
        FleetMonitor() as monitor,
    ):
        monitor.wait_until_running(fleet)
        monitor.listen(SETTLED, fleet.check)
        before, used, begin = monitor.snapshots(fleet), fleet.processor_time(), time.monotonic()
        monitor.listen(duration, fleet.check)
        cpu = (fleet.processor_time() - used) / (time.monotonic() - begin)
        return report(before, monitor.snapshots(fleet), cpu)
