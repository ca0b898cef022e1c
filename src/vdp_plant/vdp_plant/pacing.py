"""The plant's time against the machine's: late ticks, and how old the state behind a theta is.

Pure: no ROS, and time is an argument.
"""

from __future__ import annotations

import math

KEPT = 4096  # states whose sending time is kept: 20 s at 200 Hz


class Ticks:
    """Counts the ticks of a timer that came too late to be made up for.

    A timer drops periods that are past; a tick this late has taken the place of several. They are
    never run in a burst: simulated time falls behind instead. ``period`` [s] is the time between
    two ticks, ``behind`` [s] how much later than its time the last one was.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._due = math.inf
        self.behind = 0.0

    def start(self, now: float) -> None:
        """Begin at a steady time [s]; the first tick is due a period later."""
        self._due = now + self._period

    def tick(self, now: float) -> int:
        """Take note of a tick; return how many others it has taken the place of."""
        self.behind = now - self._due
        late = max(math.floor(self.behind / self._period), 0)
        self._due += (late + 1) * self._period
        return late


class SentStates:
    """When each state was published, so that an answer has the age of what it answers.

    ``period`` [s] is the shortest time between two states.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._sent = [math.nan] * KEPT
        self._last = -1

    def send(self, step: int, now: float) -> None:
        """Take note of a state that goes out."""
        self._sent[step % KEPT] = now
        self._last = step

    def age(self, step: int, now: float) -> float:
        """Return how long ago the state of a step was published [s]; NaN if it was not, here.

        For a state that is further back than what is kept it is the least that can be.
        """
        if not 0 <= step <= self._last:
            return math.nan
        if self._last - step < KEPT:
            return now - self._sent[step % KEPT]
        return (self._last - step) * self._period
