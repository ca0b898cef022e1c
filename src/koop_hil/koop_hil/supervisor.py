"""Runs a scenario: its processes, its events on time, and the levels on /diagnostics."""

from __future__ import annotations

import heapq
import itertools
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from koop_bringup.live.monitor import Monitor
from koop_bringup.live.process import START_TIMEOUT
from koop_core.config.knobs import format_knobs
from koop_core.errors import LiveError
from koop_core.stream.report import LEVELS
from koop_hil.actions import PUBLISHING, act
from koop_hil.hosts import other_host
from koop_hil.processes import Processes
from koop_hil.scenario import Scenario
from koop_node.client.alone import alone

TICK = 0.02  # [s] between looks at the clock


@dataclass
class RunRecord:
    """Times, levels and failures of a run."""

    begin: int = 0
    end: int = 0
    """System time of the first and last moment [ns]."""
    first: int = 0
    """When the first event began [ns], or the run if there is none."""
    levels: dict[str, set[str]] = field(default_factory=dict)
    """Levels that every node reported after the first event, or in the whole run without events."""
    failures: list[str] = field(default_factory=list)
    """Processes that ended on their own, with their last lines; publishers that are not the
    scenario's; events that did not happen."""


def run(scenario: Scenario, folder: Path, progress: Callable[[float, str], None]) -> RunRecord:
    """Run a scenario in a folder to its end.

    Raises LiveError if the loop doesn't start, or a stranger publishes on its topics.
    """
    with ExitStack() as stack:
        other = None
        if scenario.setting.remote:  # before the monitor: DDS looks for devices once
            other = stack.enter_context(other_host())
        else:  # with two hosts no other process is on the network
            stack.enter_context(alone(topics=dict.fromkeys(scenario.topics, 1)))
        monitor = stack.enter_context(Monitor())
        processes = stack.enter_context(Processes(folder, scenario, monitor, other))
        monitor.wait_for(
            lambda: "step" in monitor.progress.values.get("koopman_lifter", {}),
            START_TIMEOUT,
            f"a state (see {processes.logs})",
            processes.refuse_dead,
        )
        refuse_others(monitor, scenario.topics)
        record = _play(scenario, processes, progress)
    record.failures += [text for text in processes.failures if text not in record.failures]
    return record


def _play(
    scenario: Scenario, processes: Processes, progress: Callable[[float, str], None]
) -> RunRecord:
    setting, monitor, record = scenario.setting, processes.monitor, RunRecord()
    started = time.monotonic()
    record.begin = time.time_ns()
    order = itertools.count()
    todo = [(event.at, next(order), event, False) for event in scenario.events]
    heapq.heapify(todo)
    first = min((event.at for event in scenario.events), default=0.0)
    looked = 0.0
    # a publisher that was killed counts for a while
    changing = any(event.action in PUBLISHING for event in scenario.events)
    while (t := (time.monotonic() - started) * setting.time_scale) < setting.duration:
        monitor.spin(TICK)
        while todo and todo[0][0] <= t:
            _, _, event, over = heapq.heappop(todo)
            record.first = record.first or time.time_ns()
            act(processes, event.action, event.what, over)
            if not over and (event.lasts > 0.0 or event.action == "kill"):
                heapq.heappush(todo, (t + event.lasts, next(order), event, True))
        if t >= first:
            for node, level in monitor.progress.levels.items():
                record.levels.setdefault(node, set()).add(LEVELS[level])
        record.failures += processes.dead()
        if record.failures:
            break
        if time.monotonic() - looked > 1.0:
            looked = time.monotonic()
            progress(t, f"theta {format_knobs(monitor.theta, '+.2f')}")
            if not changing:
                refuse_others(monitor, scenario.topics)
    record.end = time.time_ns()
    record.first = record.first or record.begin
    if not record.failures:
        record.failures += [
            f"'{event}' did not happen: the run was over" for *_, event, over in todo if not over
        ]
    return record


def refuse_others(monitor: Monitor, topics: Sequence[str]) -> None:
    """Raise LiveError if a topic has a publisher besides the run's own."""
    for topic in topics:
        if (count := monitor.node.count_publishers(topic)) > 1:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise LiveError(
                f"{count} publishers on '{topic}', 1 of this run: another loop runs on this ROS "
                f"domain; set ROS_DOMAIN_ID (now {domain}) to a free one"
            )
