"""Simulated loops in namespaces of one ROS domain, several to a container."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from koop_bringup.live.fleet_report import Snapshot, snapshot
from koop_bringup.live.process import START_TIMEOUT, NodeProcess, uninterrupted
from koop_core.config import parameter_file
from koop_core.errors import LiveError
from koop_loop.parameters import COMPONENTS
from koop_node.client.alone import alone
from koop_node.client.client import Client

LEVELS = ("OK", "WARN", "ERROR", "STALE")


class Fleet:
    """The containers of a fleet; a context manager that leaves none behind.

    Loop k is in the namespace ``/loopk`` and in container k modulo their number.

    Parameters
    ----------
    folder : Path
        Receives logs and parameters.
    loops : int
        How many.
    values : mapping of str to mapping
        Parameters of the nodes by name, the same for all loops.
    containers : int
        Processes; by default one a processor that this process may use, and no more than loops.
    pinned : bool
        Whether each container keeps to a processor of its own.
    """

    def __init__(
        self,
        folder: Path,
        loops: int,
        values: Mapping[str, Mapping[str, Any]],
        containers: int = 0,
        pinned: bool = False,
    ) -> None:
        self.folder = folder
        self.namespaces = [f"/loop{number}" for number in range(loops)]
        self._values = values
        self._processors = processors()
        self._containers = min(containers or len(self._processors), loops)
        self._pinned = pinned
        self.processes: list[NodeProcess] = []
        self._stack = ExitStack()

    def __enter__(self) -> Fleet:
        with ExitStack() as stack:
            stack.enter_context(alone("/loop0"))
            self.folder.mkdir(parents=True, exist_ok=True)
            stack.callback(self.stop)
            for number in range(self._containers):
                self.processes.append(self._start(number))
            self._stack = stack.pop_all()
        return self

    def _start(self, number: int) -> NodeProcess:
        file = self.folder / f"given_parameters{number}.yaml"
        own = {}
        if self._pinned:
            own = {"cpus": str(self._processors[number % len(self._processors)])}
        values = {name: {**self._values.get(name, {}), **own} for name in COMPONENTS}
        parameter_file.write(values, file)
        words = [
            f"{component}@{namespace}"
            for namespace in self.namespaces[number :: self._containers]
            for component in COMPONENTS.values()
        ]
        log = self.folder / f"container{number}.log"
        return NodeProcess("container", [*words, "--ros-args", "--params-file", str(file)], log)

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


class FleetMonitor(Client):
    """What the nodes of all loops last reported on /diagnostics.

    Attributes
    ----------
    values : dict
        By the node's full name, such as ``/loop0/vdp_plant``.
    said : dict
        When it said so, by its own clock [s].
    findings : dict
        By the node's full name, of those that are not OK.
    """

    def __init__(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        super().__init__("koop_fleet")
        self.values: dict[str, dict[str, str]] = {}
        self.said: dict[str, float] = {}
        self.findings: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 1000)

    def listen(self, seconds: float, check: Callable[[], object]) -> None:
        """Listen for a time; ``check`` is called meanwhile and may raise."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin(0.2)
            check()

    def snapshots(self, fleet: Fleet) -> list[Snapshot]:
        """Return what each loop last said."""
        return [snapshot(name, self.values, self.said) for name in fleet.namespaces]

    def wait_until_running(self, fleet: Fleet, steps: int = 1) -> None:
        """Wait until every plant of a fleet has done so many steps.

        Raises
        ------
        LiveError
            If one does not begin, or a container ends.
        """
        waiting = [f"{namespace}/vdp_plant" for namespace in fleet.namespaces]
        deadline = time.monotonic() + START_TIMEOUT + 0.5 * len(waiting)

        def ready() -> bool:
            return all(int(self.values.get(name, {}).get("step", 0)) >= steps for name in waiting)

        try:
            self.wait_for(ready, deadline - time.monotonic(), "all loops", fleet.check)
        except LiveError as error:
            silent = [n for n in waiting if int(self.values.get(n, {}).get("step", 0)) < steps]
            raise LiveError(
                f"{error}: {', '.join(silent)} did not begin; see {fleet.folder}"
            ) from None

    def _on_message(self, message: Any) -> None:
        stamp = message.header.stamp
        for status in message.status:
            name = status.name.split(":")[0]
            self.values[name] = {item.key: item.value for item in status.values}
            self.said[name] = stamp.sec + 1e-9 * stamp.nanosec
            self.findings.pop(name, None)
            if level := status.level[0]:
                self.findings[name] = f"{LEVELS[level]}: {status.message}"


def processors() -> list[int]:
    """Return the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))
