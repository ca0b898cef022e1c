"""Runs a scenario: its processes, its events on time, and the levels on /diagnostics."""

from __future__ import annotations

import heapq
import itertools
import os
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from koop_bringup.live.monitor import LEVELS, Monitor
from koop_bringup.live.process import START_TIMEOUT
from koop_core.errors import LiveError
from koop_hil.hosts import OtherHost, other_host
from koop_hil.processes import Processes
from koop_hil.scenario import SECOND, Event, Scenario
from koop_node.client.alone import alone
from vdp_plant.config import PlantConfig

FIRST = "relay_esc"
MORE_PUBLISHERS = ("kill", "cut", "handover", SECOND)  # events with more publishers than usual
PATIENCE = 5.0  # [s] until a theta is heard
ARRIVAL = 0.05  # [s] that the last theta may be under way
TICK = 0.02  # [s] between looks at the clock


@dataclass
class RunRecord:
    """What happened in a run.

    Attributes
    ----------
    begin, end : int
        System time of the first and last moment [ns].
    happened : list of (int, Event)
        When events began [ns].
    levels : dict
        Levels that every node reported after the first event, or in the whole run without events.
    failures : list of str
        Processes that ended on their own, with their last lines; publishers that are not the
        scenario's; events that did not happen.
    memory : list of (float, dict)
        Time [s] and resident memory of every process [MB], about once a second.
    round_trip : list of (float, float)
        Time [s] and time from state to theta [ms], where the plant reports it.
    """

    begin: int = 0
    end: int = 0
    happened: list[tuple[int, Event]] = field(default_factory=list)
    levels: dict[str, set[str]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
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
            if self._other_host is None:  # else no other process is on the network
                stack.enter_context(alone(topics=self._scenario.publishers))
            monitor = stack.enter_context(Monitor())
            processes = stack.enter_context(
                Processes(self._folder, self._scenario, other_host=self._other_host)
            )
            monitor.wait_for(
                lambda: "step" in monitor.progress.values.get("koopman_lifter", {}),
                START_TIMEOUT,
                f"a state (see {processes.logs})",
                processes.refuse_dead,
            )
            refuse_others(monitor, self._scenario.publishers)
            if self._scenario.second_controller:
                monitor.change_state(SECOND, "configure", START_TIMEOUT)
            self._play(monitor, processes)
        known = self._record.failures
        known += [failure for failure in processes.failures if failure not in known]
        return self._record

    def _play(self, monitor: Monitor, processes: Processes) -> None:
        setting, record = self._scenario.setting, self._record
        started = time.monotonic()
        record.begin = time.time_ns()
        order = itertools.count()
        todo: list[tuple[float, int, Event, bool]] = [
            (event.at, next(order), event, False) for event in self._scenario.events
        ]
        heapq.heapify(todo)
        first = min((event.at for event in self._scenario.events), default=0.0)
        looked = 0.0
        # a publisher that was killed counts for a while
        changing = any(event.action in MORE_PUBLISHERS for event in self._scenario.events)
        while (t := self._simulated(monitor, time.monotonic() - started)) < setting.duration:
            monitor.spin(TICK)
            while todo and todo[0][0] <= t:
                _, _, event, over = heapq.heappop(todo)
                if not over:
                    record.happened.append((time.time_ns(), event))
                self._do(event, over, monitor, processes)
                if not over and event.lasts > 0.0:
                    heapq.heappush(todo, (t + event.lasts, next(order), event, True))
            if t >= first:
                for node, level in monitor.levels.items():
                    record.levels.setdefault(node, set()).add(LEVELS[level])
            for name in processes.dead():
                record.failures.append(processes.end(name))
            if record.failures:
                break
            if time.monotonic() - looked > 1.0:
                looked = time.monotonic()
                record.memory.append((looked - started, processes.memory()))
                reported = monitor.progress.values.get("vdp_plant", {}).get("round_trip_ms", "nan")
                record.round_trip.append((looked - started, float(reported)))
                self._progress(t, f"theta {monitor.theta:+.2f}")
                if not changing:
                    refuse_others(monitor, self._scenario.publishers)
        record.end = time.time_ns()
        for _, _, event, over in todo:
            if not over and not record.failures:
                record.failures.append(f"'{event}' did not happen: the run was over")

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
        elif event.action == SECOND:
            monitor.change_state(SECOND, "deactivate" if over else "activate")
        elif event.action == "handover":
            handover(monitor, *((SECOND, FIRST) if over else (FIRST, SECOND)))
        elif event.action == "inject":
            for topic, fault in event.what.items():
                text = "ok" if over else fault
                monitor.set_parameters("fault_injector", {f"{topic}_fault": text})
        elif not over:
            for node, values in event.what.items():
                monitor.set_parameters(node, values)


def refuse_others(monitor: Monitor, publishers: Mapping[str, int]) -> None:
    """Raise LiveError if topics have more publishers than the run's own."""
    for topic, own in publishers.items():
        if (count := monitor.count_publishers(topic)) > own:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise LiveError(
                f"{count} publishers on '{topic}', {own} of this run: another loop runs on this "
                f"ROS domain; set ROS_DOMAIN_ID (now {domain}) to a free one"
            )


def handover(monitor: Monitor, old: str, new: str) -> None:
    """Let another controller go on from the theta of the active one, by ROS 2's own means.

    At no time both are active.

    Raises
    ------
    LiveError
        If no theta comes, or a node refuses or does not answer.
    """
    from koop_msgs.msg import ControlInput
    from std_srvs.srv import Trigger

    heard: list[float] = []
    subscription = monitor.node.create_subscription(
        ControlInput, "theta", lambda message: heard.append(message.theta), 1
    )
    try:
        monitor.wait_for(lambda: heard, PATIENCE, f"a theta of {old}")
        monitor.change_state(old, "deactivate")
        deadline = time.monotonic() + ARRIVAL
        while time.monotonic() < deadline:
            monitor.spin(TICK)
    finally:
        monitor.node.destroy_subscription(subscription)
    monitor.set_parameters(new, {"theta_initial": heard[-1]})
    if not monitor.call(Trigger, f"/{new}/reset", Trigger.Request()).success:
        raise LiveError(f"{new} cannot be reset")
    monitor.change_state(new, "activate")
