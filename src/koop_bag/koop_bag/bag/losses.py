"""Lost messages, counted from the step index that every message of the loop carries."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class StepReport:
    """What the steps of one topic say, in the order in which they were received.

    Attributes
    ----------
    count : int
        Messages received.
    lost : int
        Steps jumped over: a step k followed by k + 1 + n counts n.
    duplicates : int
        Messages with the step of the one before: a state sent again is no loss.
    backward : int
        Messages with a smaller step than the one before: a restart of the publisher, or messages
        out of order.
    first, last : int
        First and last step received, -1 if there is none. A run starts at 0; `first` > 0 is a late
        recorder.
    """

    count: int = 0
    lost: int = 0
    duplicates: int = 0
    backward: int = 0
    first: int = -1
    last: int = -1


def count_losses(steps: ArrayLike) -> StepReport:
    """Report on a column of steps, shape (n,)."""
    k = np.asarray(steps).astype(np.int64)
    if k.size == 0:
        return StepReport()
    jump = np.diff(k)
    return StepReport(
        count=int(k.size),
        lost=int((jump[jump > 1] - 1).sum()),
        duplicates=int((jump == 0).sum()),
        backward=int((jump < 0).sum()),
        first=int(k[0]),
        last=int(k[-1]),
    )


def early_ends(last: Mapping[str, int]) -> dict[str, int]:
    """Steps that topics lack at their end, which no gap shows.

    Parameters
    ----------
    last : mapping of str to int
        Last step by topic. Topics of one namespace belong to one loop.

    Returns
    -------
    dict of str to int
        Missing steps by topic, for topics that end more than a step before the loop's last: one
        step is what a loop may be stopped within.
    """
    ends: dict[str, int] = {}
    for topic, step in last.items():
        loop = topic.rpartition("/")[0]
        ends[loop] = max(ends.get(loop, -1), step)
    missing = {topic: ends[topic.rpartition("/")[0]] - step for topic, step in last.items()}
    return {topic: count for topic, count in missing.items() if count > 1}


class StepCounter:
    """`count_losses`, one message at a time."""

    __slots__ = ("_before", "backward", "count", "duplicates", "first", "last", "lost")

    def __init__(self) -> None:
        self.count = self.lost = self.duplicates = self.backward = 0
        self.first = self.last = -1
        self._before: int | None = None

    def add(self, step: int) -> None:
        """Count one message."""
        if self._before is not None:
            jump = step - self._before
            if jump > 1:
                self.lost += jump - 1
            elif jump == 0:
                self.duplicates += 1
            elif jump < 0:
                self.backward += 1
        elif self.count == 0:
            self.first = step
        self.last = self._before = step
        self.count += 1

    def add_many(self, steps: ArrayLike) -> None:
        """Count a column of messages, shape (n,)."""
        k = np.asarray(steps).astype(np.int64)
        if k.size == 0:
            return
        before = self._before
        if before is None:
            before = int(k[0])
            self.add(before)
            k = k[1:]
        found = count_losses(np.insert(k, 0, before))
        self.count += k.size
        self.lost += found.lost
        self.duplicates += found.duplicates
        self.backward += found.backward
        self.last = self._before = found.last

    def interrupt(self) -> None:
        """Do not compare the next message with the last one: those between were not wanted."""
        self._before = None

    def report(self) -> StepReport:
        """Return the report up to now."""
        return StepReport(
            self.count, self.lost, self.duplicates, self.backward, self.first, self.last
        )
