"""Lost messages, counted from the step index that every message of the loop carries."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from koop_core.config.parameter import Settings, judged, parameter


@dataclass(frozen=True)
class LossSettings(Settings):
    """Which gaps of the steps are losses, and when a topic is silent."""

    aside: int = judged(
        100, "messages in which a sequence that another publisher interrupted continues", low=1
    )
    jump: int = parameter(
        1_000_000, "steps that no recording lacks; more: another publisher or a clock", low=1,
        origin="83 minutes at 200 Hz",
    )  # fmt: skip
    silence: float = judged(
        5.0,
        "time without a message of a publisher that is there and sent before",
        unit="s",
        low=0.0,
    )


LOSSES = LossSettings()


@dataclass(slots=True)
class StepReport:
    """Losses of one topic, from its steps in the order in which they were received."""

    count: int = 0
    """Messages received."""
    lost: int = 0
    """Steps jumped over: a step k followed by k + 1 + n counts n. A step that goes back, of a
    restarted run or of a second publisher, is not a loss. Neither is the step forward from it to
    where the steps before it continue, nor a jump."""
    duplicates: int = 0
    """Messages with the step of the one before: a state sent again is not a loss."""
    backward: int = 0
    """Messages with a smaller step than the one before: a restarted publisher, a second one, or
    messages out of order."""
    jumps: int = 0
    """Steps ahead by more than LOSSES.jump."""
    inactive: int = 0
    """Steps jumped over while the recorder or the publishing node was inactive: not lost."""
    first: int = -1
    last: int = -1
    """First and last step received, -1 if there is none. A run starts at 0; `first` > 0 is a late
    recorder."""


class LossCounter(StepReport):
    """A report that grows by one message, or by one column, at a time."""

    __slots__ = ("_aside", "_patience", "interrupted")

    def __init__(self) -> None:
        super().__init__()
        self.interrupted = True
        """Whether nothing says that a message follows: none has come, or the sequence ended."""
        # the last step before one that went back, while what continues it is expected
        self._aside = -1
        self._patience = 0

    def add(self, step: int) -> None:
        """Count one message."""
        before, self.last = self.last, step
        self.count += 1
        if self.interrupted:
            self.interrupted = False
            if self.count == 1:
                self.first = step
            else:
                self.inactive += max(0, step - before - 1)
            return
        if self._patience:
            self._patience -= 1
            if before < self._aside <= step:  # the interrupted sequence continues
                before, self._aside = self._aside, before
                self._patience = LOSSES.aside
        if step > before + LOSSES.jump:
            self.jumps += 1
        elif step > before:
            self.lost += step - before - 1
        elif step == before:
            self.duplicates += 1
        else:
            self.backward += 1
            self._aside, self._patience = before, LOSSES.aside

    def add_many(self, steps: ArrayLike) -> None:
        """Count a column of messages, shape (n,)."""
        values = np.asarray(steps)
        if values.dtype.kind != "u":
            values = values.astype(np.int64)
        if values.size == 0:
            return
        self.add(int(values[0]))
        k = values.astype(np.int64)
        ahead = k[1:] - k[:-1]
        if not self._patience and 0 <= k[0] <= k[-1] and (ahead == 1).all():  # as nearly always
            self.count += ahead.size
            self.last = int(k[-1])
            return
        if self._patience or (ahead < 0).any() or (k < 0).any():  # of 2**63, ahead wraps around
            for step in values[1:].tolist():
                self.add(step)
            return
        near = ahead <= LOSSES.jump
        self.count += ahead.size
        self.lost += int(np.maximum(ahead - 1, 0)[near].sum())
        self.duplicates += int((ahead == 0).sum())
        self.jumps += int((~near).sum())
        self.last = int(k[-1])

    def interrupt(self) -> None:
        """Do not compare the next message with the last one: none was expected between them."""
        self.interrupted = True
        self._patience = 0


def count_losses(steps: ArrayLike) -> StepReport:
    """Report on a column of steps, shape (n,)."""
    counter = LossCounter()
    counter.add_many(steps)
    return counter


def early_ends(last: Mapping[str, int]) -> dict[str, int]:
    """Return the steps, by topic, that topics lack at their end, which no gap shows.

    Topics of one namespace belong to one loop. Those that end at most a step before the loop's last
    are left out: one step is what a loop may be stopped within.
    """
    ends: dict[str, int] = {}
    for topic, step in last.items():
        loop = topic.rpartition("/")[0]
        ends[loop] = max(ends.get(loop, -1), step)
    missing = {topic: ends[topic.rpartition("/")[0]] - step for topic, step in last.items()}
    return {topic: count for topic, count in missing.items() if count > 1}
