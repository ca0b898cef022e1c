"""Simulated loops in namespaces of one ROS domain, several to a container."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from koop_bench.figures import processor_time, processors
from koop_bench.fleet_report import Counts, FleetReport, counts_of, report
from koop_bringup.live.process import START_TIMEOUT, NodeProcess, uninterrupted
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_loop.parameters import COMPONENTS, make
from koop_node.client.alone import alone
from koop_node.client.client import Client

SETTLED = 2.0  # [s] after the last loop has begun
DT = 0.005  # [s] of a step, simulated


class Fleet(Client):
    """The containers of a fleet, and the last reports of its nodes on /diagnostics.

    Loop k is in the namespace ``/loopk`` and in container k modulo their number. Values and times
    [s] of the reports, by the nodes' own clocks, are kept by full name, such as
    ``/loop0/vdp_plant``.
    """

    def __init__(self, namespaces: list[str], processes: list[NodeProcess]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        super().__init__("koop_fleet")
        self.namespaces = namespaces
        self.processes = processes
        self.values: dict[str, dict[str, str]] = {}
        self.times: dict[str, float] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 1000)

    def check(self) -> None:
        """Raise LiveError if a container has ended."""
        for process in self.processes:
            if process.poll() is not None:
                raise process.failure()

    def processor_time(self) -> float:
        """Return the processor time that all containers have used [s]."""
        return sum(processor_time(process.process.pid) for process in self.processes)

    def listen(self, seconds: float) -> None:
        """Listen for a time."""
        self.spin_until(lambda: False, seconds, self.check)

    def counts(self) -> list[Counts]:
        """Return the last report of each loop."""
        return [counts_of(name, self.values, self.times) for name in self.namespaces]

    def wait_until_running(self, steps: int = 1) -> None:
        """Wait until every plant has done so many steps; raise LiveError if one does not."""
        waiting = {f"{namespace}/vdp_plant" for namespace in self.namespaces}

        def ready() -> bool:
            begun = {n for n in waiting if int(self.values.get(n, {}).get("step", 0)) >= steps}
            waiting.difference_update(begun)
            return not waiting

        try:
            self.wait_for(ready, START_TIMEOUT + 0.5 * len(waiting), "all loops", self.check)
        except LiveError as error:
            names, log = ", ".join(sorted(waiting)[:3]), self.processes[0].log
            raise LiveError(
                f"{error}: {len(waiting)} plants did not begin, such as {names}; see {log.parent}"
            ) from None

    def _on_message(self, message: Any) -> None:
        stamp = message.header.stamp
        for status in message.status:
            name = status.name.split(":")[0]
            self.values[name] = {item.key: item.value for item in status.values}
            self.times[name] = stamp.sec + 1e-9 * stamp.nanosec


@contextmanager
def fleet(
    folder: Path, loops: int, values: Mapping[str, Mapping[str, Any]], containers: int = 1
) -> Iterator[Fleet]:
    """Run so many loops, in no more containers, while the context lasts.

    The folder receives logs and parameters; ``values`` are the nodes' parameters by name, the same
    for all loops.
    """
    namespaces = [f"/loop{number}" for number in range(loops)]
    containers = min(containers, loops)
    processes: list[NodeProcess] = []
    with alone("/loop0"):
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / "given_parameters.yaml"
        parameter_file.write({name: values.get(name, {}) for name in COMPONENTS}, file)
        try:
            for number in range(containers):
                words = [
                    f"{component}@{namespace}"
                    for namespace in namespaces[number::containers]
                    for component in COMPONENTS.values()
                ]
                words += ["--ros-args", "--params-file", str(file)]
                log = folder / f"container{number}.log"
                processes.append(NodeProcess("container", words, log))
            with Fleet(namespaces, processes) as running:
                yield running
        finally:
            _stop(processes)


@uninterrupted()
def _stop(processes: list[NodeProcess]) -> None:
    """End the containers, all at once."""
    for process in processes:
        process.ask_to_stop()
    for process in processes:
        process.stop()


def parameters_at(rate: float, priority: int = 0) -> dict[str, dict[str, Any]]:
    """Return the nodes' parameters for a rate [Hz]; with a real-time priority, locked in memory."""
    pace: dict[str, Any] = {"pace": "realtime"}
    if abs(rate * DT - 1.0) > 1e-9:
        pace = {"pace": "scaled", "time_scale": rate * DT}
    values: dict[str, dict[str, Any]] = {name: {"priority": priority} for name in COMPONENTS}
    values["vdp_plant"] |= {**pace, "duration": 0.0}
    make(values)
    return values


def measure_fleet(loops: int, rate: float, duration: float, priority: int = 0) -> FleetReport:
    """Run a fleet at a rate [Hz]; return its report over a time [s] once all loops had settled.

    It has a container for each processor that this process may use.
    """
    values = parameters_at(rate, priority)
    with (
        tempfile.TemporaryDirectory() as folder,
        fleet(Path(folder), loops, values, processors()) as running,
    ):
        running.wait_until_running()
        running.listen(SETTLED)
        before, used, begin = running.counts(), running.processor_time(), time.monotonic()
        running.listen(duration)
        cpu = (running.processor_time() - used) / (time.monotonic() - begin)
        return report(before, running.counts(), cpu)
