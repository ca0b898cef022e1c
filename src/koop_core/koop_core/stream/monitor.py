"""Watches one input of a node: what a message's step means, how old it is, what went missing.

Pure: no ROS, and time is an argument. What a sample *does* depends only on the messages, so that a
replay at any speed decides the same; what is *reported* depends on the steady clock.

One meaning of every timeout, in seconds, 0 = off: an input is stale if its newest usable message is
older than that. The first message after a silence of that length, by its step, follows on nothing:
filters must not take its difference to the last one.

A message that is stale on arrival, one of many that were kept while a link was cut, is not even
that: it moves nothing and is not answered, so that a recording shows by the missing answer that it
was not heard.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from koop_core.clock import make_clock
from koop_core.stream.age import UNKNOWN, Clocks, age
from koop_core.stream.arrival import NOTHING, Arrival, Heard, classify, timeout_of
from koop_core.stream.fresh import Freshness
from koop_core.stream.report import ERROR, GHOST, OK, STALE, WARN, NodeFinding
from koop_core.stream.settings import STREAM

LARGEST = 2**63 - 2
"""Largest step."""


class StreamMonitor:
    """Follows the steps of one topic, which are ``dt`` [s] apart.

    At an age of ``timeout`` [s] the input is stale; 0: never. With ``may_end``, silence is not a
    fault where the source has left in order; with ``newest_counts``, lost and overtaken messages
    are not a finding, as commands in real time.
    """

    def __init__(
        self,
        topic: str,
        timeout: float,
        dt: float,
        may_end: bool = False,
        newest_counts: bool = False,
    ) -> None:
        self.topic = topic
        self.timeout = timeout
        self.dt = dt
        self._may_end = may_end
        self._newest_counts = newest_counts
        self.count = 0
        self.missed = self.repeated = self.late = self.restarts = self.silences = 0
        self.unusable = self.too_old = 0
        self.problem = ""
        self._stamp = 0.0
        self.heard = math.nan
        """Steady time of the newest message [s]."""
        self._stream = NOTHING
        self._reported: tuple[int, ...] = (0,) * 6
        self.clocks = UNKNOWN
        """Of its writer."""
        self._silent = False  # whether its source was silent for long and still there
        self._paused = False

    @property
    def step(self) -> int | None:
        """Step of the newest message; None before the first."""
        return self._stream.step if self._stream.step >= 0 else None

    def hear_message(self, message: Any, now: float, written: float) -> Arrival:
        """Say what a state or a cost is; in lockstep its age does not matter."""
        stamp = message.header.stamp
        seconds = stamp.sec + 1e-9 * stamp.nanosec
        return self.hear(message.step, seconds, now, math.nan if message.lockstep else written)

    def hear(self, step: int, stamp: float, now: float, written: float = math.nan) -> Arrival:
        """Say what a message is, by its step.

        Its stamp [s] is in whatever clock its source has, ``now`` the steady time of its arrival
        [s], ``written`` a time on the clock of its writer's host [s]; NaN where age does not
        matter, as in lockstep: its source waits for the answer.
        """
        last = self._stream.step
        if step > LARGEST:  # of a message's 64 bits, kernels take 63
            self.reject(f"step {step}: no run is that long")
            return Arrival.TOO_OLD
        if not math.isnan(written):
            if step < last - STREAM.window:
                self.clocks = UNKNOWN
            old, self.clocks = age(self.clocks, written, now)
            if 0.0 < self.timeout < old:
                self.too_old += 1
                return Arrival.TOO_OLD
        self.heard, self._stamp, self._silent = now, stamp, False
        arrival, self._stream = classify(self._stream, step, self.timeout, self.dt)
        if arrival is Arrival.REPEAT:
            self.repeated += 1
        elif arrival is Arrival.LATE:
            self.late += 1
        else:
            self.count += 1
            if arrival is Arrival.NEXT or arrival is Arrival.RESUME:
                self.missed += 0 if self._paused else step - last - 1
                self.silences += arrival is Arrival.RESUME
            else:
                self.restarts += last >= 0
            self._paused = False
        return arrival

    @property
    def steady(self) -> bool:
        """Whether the next message may follow on the last one."""
        return self._stream.step >= 0 and not self._paused

    def follow_on(self, count: int, stamp: float, now: float, clocks: Clocks = UNKNOWN) -> None:
        """Take note of messages that followed each on the last, heard until a steady time [s]."""
        self.count += count
        self.clocks = clocks
        self._stream = Heard(self._stream.step + count, 0)
        self.heard, self._stamp, self._silent = now, stamp, False

    def freshness(self, lockstep: bool) -> Freshness:
        """Return what decides whether compiled code may answer a message."""
        return Freshness(lockstep, self.timeout, make_clock())

    def follow(self, dt: float) -> None:
        """Take the stream for one of another sampling time [s], which follows on nothing."""
        self.dt, self.timeout, self._stream = dt, timeout_of(dt), NOTHING

    def pause(self) -> None:
        """Stop listening, as an inactive node does: steps until the next message are not missed."""
        self._paused = True

    def watch_from(self, now: float) -> None:
        """Let the age count from ``now`` although nothing was heard yet."""
        self.heard = now

    def reject(self, problem: str) -> None:
        """Count a message whose content cannot be used."""
        self.unusable += 1
        self.problem = problem

    def age(self, now: float) -> float:
        """Return the time since the last message [s]; NaN before the first."""
        return now - self.heard

    def stale(self, now: float) -> bool:
        """Return True if the timeout has passed since the last message."""
        return 0.0 < self.timeout < self.age(now)

    def latency(self, now: float, wall: float) -> float:
        """Return from stamp to arrival of the last message [s]; NaN without stamps in real time.

        ``now`` and ``wall`` are the same instant on the steady and on the system clock.
        """
        latency = wall - self.age(now) - self._stamp
        return latency if abs(latency) < 60.0 else math.nan

    def findings(
        self,
        now: float,
        publishers: int,
        can_say_more: bool = True,
        unheard: Sequence[str] = (),
    ) -> Iterator[NodeFinding]:
        """Say what is wrong at a steady time [s]; counts are those since the last call.

        ``publishers`` is their number, ``can_say_more`` whether one of them may have something to
        say, for its own source has not left, ``unheard`` says which of them cannot be heard.
        """
        counts = (
            self.unusable, self.missed, self.late, self.restarts, self.repeated, self.too_old
        )  # fmt: skip
        unusable, missed, late, restarts, repeated, too_old = (
            new - old for new, old in zip(counts, self._reported, strict=True)
        )
        self._reported = counts
        for text in unheard:
            yield NodeFinding(ERROR, text)
        if publishers > 1:
            text = f"{publishers} publishers on '{self.topic}' ({GHOST})"
            yield NodeFinding(ERROR, text)
        if unusable:
            yield NodeFinding(ERROR, f"{unusable} unusable on '{self.topic}', last {self.problem}")
        if math.isnan(self.heard) and not unheard:
            source = "its publisher is silent" if publishers else "no publisher"
            yield NodeFinding(WARN, f"nothing on '{self.topic}' yet: {source}", at_once=False)
        if self.stale(now):
            if self._may_end and not (publishers and can_say_more) and not self._silent:
                yield NodeFinding(OK, f"'{self.topic}' has ended at step {self.step}")
            else:  # a source that was lost stays so when discovery gives it up
                self._silent |= self.age(now) > STREAM.leaving
                text = f"nothing on '{self.topic}' for {self.age(now):.1f} s"
                yield NodeFinding(STALE, f"{text}, timeout {self.timeout:g} s")
        if restarts:
            yield NodeFinding(WARN, f"steps on '{self.topic}' went back")
        noted = [(repeated, "repeated"), (too_old, "too old")]
        if not self._newest_counts:
            noted = [(missed, "missed"), (late, "late"), *noted]
        for number, what in noted:
            if number:
                yield NodeFinding(WARN, f"{number} {what} on '{self.topic}'")

    def values(self, now: float, wall: float, publishers: int) -> dict[str, object]:
        """Return the figures for /diagnostics."""
        latency = self.latency(now, wall)
        values: dict[str, object] = {"age_s": f"{self.age(now):.3f}"}
        if math.isfinite(latency):
            values["latency_ms"] = f"{latency * 1e3:.2f}"
        values["missed_steps"] = self.missed
        for name in ("late", "repeated", "restarts", "silences", "unusable", "too_old"):
            values[name] = getattr(self, name)
        values |= {"publishers": publishers, "watchdog": self.watchdog(now)}
        return {f"{self.topic} {name}": value for name, value in values.items()}

    def watchdog(self, now: float) -> str:
        """Return the state of the watchdog: off, waiting, ok or stale."""
        if self.timeout == 0.0:
            return "off"
        if math.isnan(self.heard):
            return "waiting"
        return "stale" if self.stale(now) else "ok"
