"""Timers that the thread of the nodes waits for itself. Pure: no ROS.

rclpy's EventsExecutor gives every clock a thread that waits and then wakes the one that runs the
callbacks: two switches a tick, and two threads a node. Here the loop that runs the executor lets it
wait until the next timer is due.

Messages come before timers: a step that is under way ends before the next one begins, and where
there is too much to do, ticks are dropped, not messages kept waiting.
"""

from __future__ import annotations

import heapq
import itertools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

SLICE = 1e-3  # [s] for timers at a stretch: compiled ticks of 1 kHz keep their pace


class Timer(Protocol):
    """A callback that is due every period until it is cancelled."""

    def cancel(self) -> None:
        """Let it be due no more, until it is restarted."""

    def restart(self, period: float | None = None, due: float | None = None) -> None:
        """Let it be due at a steady time [s], or a period from now, a new one if one is given."""


class ScheduledTimer:
    """A timer of a schedule; see :class:`Timer`."""

    def __init__(self, schedule: Schedule, period: float, callback: Callable[[], object]) -> None:
        self._schedule = schedule
        self.callback = callback
        self.period = period
        self.restart()

    def cancel(self) -> None:
        self.due = math.inf

    def restart(self, period: float | None = None, due: float | None = None) -> None:
        if period is not None:
            self.period = period
        self.due = time.monotonic() + self.period if due is None else due
        self._schedule.push(self)


class Schedule:
    """The timers of a process, the next one first, on a steady clock [s]."""

    def __init__(self) -> None:
        self.asked = 0
        """The signal that asked the process to end; 0: none has."""
        self.ended = False
        """Whether a node has finished."""
        self._number = itertools.count()
        self._heap: list[tuple[float, int, ScheduledTimer]] = []

    def timer(self, period: float, callback: Callable[[], object]) -> ScheduledTimer:
        """Call ``callback`` every ``period`` [s], the first time after one."""
        return ScheduledTimer(self, period, callback)

    def wait(self, most: float) -> float:
        """Return how long nothing is due [s], at most ``most``; 0 if something is."""
        while self._heap and self._heap[0][0] != self._heap[0][2].due:  # it was changed
            heapq.heappop(self._heap)
        if not self._heap:
            return most
        return min(max(self._heap[0][0] - time.monotonic(), 0.0), most)

    def run_due(self) -> None:
        """Call what is due, each once: periods that are past are dropped, not made up for.

        After a slice messages have their turn, but what is due at the same time stays together.
        """
        now, due = time.monotonic(), math.nan
        while self._heap and self._heap[0][0] <= now:
            if self._heap[0][0] != due and time.monotonic() >= now + SLICE:
                break
            due, _, timer = heapq.heappop(self._heap)
            if due != timer.due:
                continue
            if timer.period > 0.0:
                timer.due += timer.period * (math.floor((now - due) / timer.period) + 1)
            timer.due = max(timer.due, math.nextafter(now, math.inf))
            self.push(timer)
            timer.callback()

    def push(self, timer: ScheduledTimer) -> None:
        """Take note of when a timer is due."""
        heapq.heappush(self._heap, (timer.due, next(self._number), timer))


_RUNNING: ContextVar[Schedule | None] = ContextVar("schedule", default=None)


@contextmanager
def running() -> Iterator[Schedule]:
    """Run a schedule: nodes that are made and spun in this context have their timers on it."""
    schedule = Schedule()
    token = _RUNNING.set(schedule)
    try:
        yield schedule
    finally:
        _RUNNING.reset(token)


def current() -> Schedule | None:
    """Return the schedule of this context; None where others spin the nodes."""
    return _RUNNING.get()
