"""How old a message is on arrival, whatever the clock of the host that wrote it. Pure: no ROS.

The time from writing to arrival, on two clocks, is the message's age plus the unknown difference of
the clocks. The smallest such delay of late stands for no age at all; what is above it is the age.

A clock that is set back, or drifts, must not make all messages old for ever. So the smallest delay
may rise, but only to what two periods of unbroken arrivals agree on. Kept messages that arrive
after a cut do not look like that: their delays fall while they drain, or there are gaps.
"""

from __future__ import annotations

import math

from koop_core.stream.settings import STREAM


class AgeMeter:
    """Tells the age of the messages of one writer."""

    def __init__(self) -> None:
        self._best = self._low = self._low_before = math.inf
        self._end = -math.inf
        self._last = math.nan

    def reset(self) -> None:
        """Forget the clock: another writer follows."""
        self._best = self._low = self._low_before = math.inf

    def age(self, written: float, now: float) -> float:
        """Return a message's age [s]; it was written on its writer's clock, and arrives ``now``."""
        delay, s = now - written, STREAM
        if now - self._last > s.gap:
            self._low = self._low_before = math.inf
            self._end = now + s.period
        elif now >= self._end:
            if self._low > self._low_before - s.fall:
                self._best = min(self._low, self._low_before)
            self._low_before, self._low = self._low, math.inf
            self._end = now + s.period
        self._last = now
        self._low = min(self._low, delay)
        self._best = min(self._best, delay)
        return delay - self._best
