"""Whether the cost has risen for good: the optimum has moved, and theta did not follow.

The mean of r over windows of so many dwell times that neither the controller's own swing nor noise
shows is compared with the best window of the run. A rig that is off has next to no cost, which is
not its best: such costs are left out once a few windows are known, and where the run began with
them, it begins anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from koop_core.config.parameter import Settings, judged, parameter

simulated = partial(
    parameter,
    origin="ten simulated rigs, 12 h and more: at most 1.25 times the least where they stay as "
    "they are, more than 2 times on six of them where the optimum leaves by 0.3 ranges",
)


@dataclass(frozen=True)
class LevelSettings(Settings):
    """What is a rise of the cost."""

    window: float = simulated(200.0, "length of a window", unit="dwell", low=20.0)
    least: int = simulated(2000, "samples of a window, at least", low=20)
    risen: float = simulated(2.0, "rise over the best window", low=1.3)
    off: float = judged(
        1e3, "rise that no optimum causes which leaves: before, the rig was off", low=10.0
    )
    known: int = judged(3, "windows, in which theta arrives, until lower costs are left out", low=1)


LEVEL = LevelSettings()


class CostLevel:
    """The level of the cost in the windows of a run, of so many dwell times [samples]."""

    def __init__(self, dwell: int, minimise: bool) -> None:
        self.rise = math.nan
        """Mean of r over the last window over that of the best one (its inverse where r is to be
        large); NaN before there was a window."""
        self.window, self._minimise = max(round(LEVEL.window * dwell), LEVEL.least), minimise
        self.sum, self.count, self._best, self._windows = 0.0, 0, math.nan, 0
        self.floor = -math.inf
        """Costs below it are left out."""

    def take(self, r: float) -> None:
        """Take a usable cost."""
        if r < self.floor:
            return
        self.sum += r
        self.count += 1
        if self.count < self.window:
            return
        level = self.sum / self.count
        self.sum, self.count, self._windows = 0.0, 0, self._windows + 1
        if self._minimise and level > LEVEL.off * self._best:
            self._best, self._windows, self.floor, self.rise = math.nan, 0, -math.inf, math.nan
            return
        if math.isnan(self._best) or (level < self._best) == self._minimise:
            self._best = level
        if self._minimise and self._windows >= LEVEL.known:
            self.floor = self._best / LEVEL.off
        low, high = sorted((level, self._best))
        self.rise = high / low if low > 0.0 else math.nan

    def finding(self) -> str:
        """Return in words that the cost has risen; empty where it has not."""
        if not self.rise >= LEVEL.risen:
            return ""
        words = "the cost is {:.3g} times the least of this run"
        if not self._minimise:
            words = "the largest cost of this run was {:.3g} times what it is now"
        return (
            f"{words.format(self.rise)}: the optimum may have moved, and theta did not follow: run "
            "'koop commission' again"
        )
