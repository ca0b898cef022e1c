"""Numbers steps for rigs whose messages carry none."""

from __future__ import annotations

from typing import Any

from koop_core.config.fields import Source, read_field
from koop_core.stream.settings import STREAM
from koop_node.node.stamps import to_seconds


class StepCounter:
    """Counts the steps of a source that says only when it measured.

    With stamps, the step grows by the whole number of periods between two of them, so that a lost
    message is a gap in the steps; jitter and a drifting clock don't add up, for only neighbours are
    compared. A message without a stamp (zero) is the next step. Counting begins at 1: step 0 is
    where a run begins, and a source without steps is under way whenever it is heard.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt  # [s] between two steps
        self._step = 0
        self._stamp = 0.0
        self.early = 0  # messages less than half a step after the one before: it is faster

    def next(self, stamp: float) -> int:
        """Return the step of a message with this stamp [s]."""
        if stamp == 0.0 or self._stamp == 0.0:  # there is nothing to compare
            self._step += 1
            self._stamp = stamp or (self._stamp and self._stamp + self._dt)
            return self._step
        since = stamp - self._stamp
        periods = round(min(max(since / self._dt, -1e15), 1e15))
        if since < 0.0 and periods >= -STREAM.window:  # overtaken; the newest stays the reference
            return max(1, self._step + min(periods, -1))
        elif since < 0.0:
            self._step = 1  # the source started again
        elif since > 0.0:
            self._step += max(periods, 1)
            self.early += periods == 0
        self._stamp = stamp
        return self._step


class StateAdapter(StepCounter):
    """Takes step, stamp and state out of any message."""

    def __init__(self, source: Source, dt: float) -> None:
        super().__init__(dt)
        self.fields = source.fields

    def convert(self, message: Any) -> tuple[int, list[float]]:
        """Return the step and the state, NaN where the message has no such number."""
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        step = self.next(to_seconds(stamp))
        return step, [read_field(path, message) for path in self.fields]
