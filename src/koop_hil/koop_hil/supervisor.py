"""Runs a scenario: the processes, the events on time, and what /diagnostics said meanwhile."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from koop_hil.hosts import OtherHost, other_host
from koop_hil.processes import Processes
from koop_hil.scenario import Event, Scenario
from koop_lab.live.loop import START_TIMEOUT, LiveError, Monitor
from vdp_plant.config import PlantConfig

LEVELS = ("OK", "WARN", "ERROR", "STALE")
TICK = 0.02  # [s] between looks at the clock


@dataclass
class RunRecord:
    """What happened in a run.

    Attributes
    ----------
    begin, end : int
        System time of the first and last moment [ns].
    happened : list of (int, int, Event)
        Begin and end of every event [ns].
    levels : dict
        Levels that every node reported after the first event, or in the whole run without events.
    crashed : list of str
        Processes that ended on their own, with their last words.
    memory : list of (float, dict)
        Time [s] and resident memory of every process [MB], about once a second.
    round_trip : list of (float, float)
        Time [s] and time from state to theta [ms], where the plant reports it.
    """

    begin: int = 0
    end: int = 0
    happened: list[tuple[int, int, Event]] = field(default_factory=list)
    levels: dict[str, set[str]] = field(default_factory=dict)
    crashed: list[str] = field(default_factory=list)
    memory: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    round_trip: list[tuple[float, float]] = field(default_factory=list)


class Supervisor:
    """Runs one scenario in a folder."""

    def __init__(
        self, scenario: Scenario, folder: Path, progress: Callable[[float, str], None]
    ) -> None:
        self._scenario = scenario
        self._folder = folder
        self._progress = progress
        self._record = RunRecord()
        self._other_host: OtherHost | None = None

    def run(self) -> RunRecord:
        """Run the scenario to its end.

        Raises
        ------
        LiveError
            If the loop doesn't start.
        """
        with ExitStack() as stack:
            if self._scenario.setting.remote:  # before the monitor: DDS looks for devices once
                self._other_host = stack.enter_context(other_host())
            monitor = Monitor()
            stack.callback(monitor.close)
            processes = stack.enter_context(
                Processes(self._folder, self._scenario, other_host=self._other_host)
            )
            self._wait_for_start(monitor, processes)
            self._play(monitor, processes)
        for name, code in processes.exit_codes:
            if code != 0:
                self._record.crashed.append(f"{name}: exit code {code}")
        return self._record

    def _wait_for_start(self, monitor: Monitor, processes: Processes) -> None:
        deadline = time.monotonic() + START_TIMEOUT
        while "step" not in monitor.progress.values.get("koopman_lifter", {}):
            monitor.spin(0.05)
            for name in processes.dead():
                raise LiveError(f"{name} ended at the start:\n{processes.last_lines(name)}")
            if time.monotonic() > deadline:
                raise LiveError(f"no state in {START_TIMEOUT:g} s: see {self._folder}/logs")

    def _play(self, monitor: Monitor, processes: Processes) -> None:
        setting, record = self._scenario.setting, self._record
        started = time.monotonic()
        record.begin = time.time_ns()
        order = itertools.count()
        todo: list[tuple[float, int, Event, int | None]] = [
            (event.at, next(order), event, None) for event in self._scenario.events
        ]
        heapq.heapify(todo)
        first = min((event.at for event in self._scenario.events), default=0.0)
        looked = 0.0
        while (t := self._simulated(monitor, time.monotonic() - started)) < setting.duration:
            monitor.spin(TICK)
            while todo and todo[0][0] <= t:
                _, _, event, begun = heapq.heappop(todo)
                now = time.time_ns()
                self._do(event, begun is not None, monitor, processes)
                if begun is None and event.lasts > 0.0:
                    heapq.heappush(todo, (t + event.lasts, next(order), event, now))
                else:
                    record.happened.append((begun or now, time.time_ns(), event))
            if t >= first:
                for node, level in monitor.levels.items():
                    record.levels.setdefault(node, set()).add(LEVELS[level])
            for name in processes.dead():
                record.crashed.append(f"{name} ended: {processes.last_lines(name)}")
            if record.crashed:
                break
            if time.monotonic() - looked > 1.0:
                looked = time.monotonic()
                record.memory.append((looked - started, processes.memory()))
                reported = monitor.progress.values.get("vdp_plant", {}).get("round_trip_ms", "nan")
                record.round_trip.append((looked - started, float(reported)))
                self._progress(t, f"theta {monitor.theta:+.2f}")
        record.end = time.time_ns()

    def _simulated(self, monitor: Monitor, elapsed: float) -> float:
        """Return the simulated time [s] after a real time."""
        if self._scenario.setting.pace == "lockstep":
            return monitor.progress.step * PlantConfig().dt
        return elapsed * self._scenario.setting.time_scale

    def _do(self, event: Event, over: bool, monitor: Monitor, processes: Processes) -> None:
        """Begin an event, or end it if it is over."""
        if event.action == "kill":
            if not over:
                processes.kill(event.what)
            if over or event.lasts == 0.0:
                processes.start(event.what)
        elif event.action == "pause":
            processes.pause(event.what, not over)
        elif event.action == "cut":
            assert self._other_host is not None  # the scenario would have been refused
            self._other_host.link(up=over)
        elif event.action == "second_controller":
            if over:
                processes.stop_second_controller()
            else:
                processes.start_second_controller(event.what)
        elif event.action == "inject":
            for topic, fault in event.what.items():
                text = "ok" if over else fault
                monitor.set_parameters("fault_injector", {f"{topic}_fault": text})
        elif not over:
            for node, values in event.what.items():
                monitor.set_parameters(node, values)
