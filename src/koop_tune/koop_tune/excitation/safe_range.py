"""The thetas that keep the bound of a constraint, found step by step from theta_safe.

On each side theta goes on from the last value at which a margin m was left, by at most a share of
the way to the bound, as the steeper of the last two slopes predicts it, of the margin and of the
logarithm of the statistic, which grows exponentially at the end of many a range:

    step = min(most, 2 last step, share m / max(-dm/du), share ln(1/s) / max(d ln s/du)),  s = 1 - m

until little margin is left, the limit of the rig file is reached, or a value broke the bound: the
way to that is halved. So the bound is approached from inside, as safe exploration asks for (Sui et
al., Safe exploration for optimization with Gaussian processes, ICML 2015).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from koop_core.config.parameter import Settings, judged, parameter
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale

ROUNDED = 1e-9  # distance of two positions that are one but for rounding, in ranges


@dataclass(frozen=True)
class SafeRangeSettings(Settings):
    """How far theta goes at a time, and when the bound is near enough."""

    first: float = judged(0.05, "first step, in ranges", low=1e-3, high=1.0)
    most: float = judged(0.15, "largest step, in ranges", low=1e-3, high=1.0)
    share: float = parameter(
        0.5, "step over the way to the bound, as it is predicted", low=0.05, high=0.9,
        origin="a margin that falls twice as fast as before is not used up",
    )  # fmt: skip
    finest: float = judged(0.005, "least step, in ranges", low=1e-4, high=0.1)
    enough: float = parameter(
        0.03, "margin that is little", low=0.0, high=0.5,
        origin="the amplitude at the bound is then known within a few per cent",
    )  # fmt: skip
    windows: int = parameter(
        3, "windows of the statistic that theta is held", low=2, origin="one forgets the way there"
    )
    longest: int = judged(12, "windows that theta is held at most, while the margin changes", low=3)
    settled: float = judged(
        0.01, "change of the margin from window to window that is none", low=0.0
    )
    slight: float = judged(
        0.02, "statistic over its bound, below which its growth says nothing", low=1e-6, high=1.0
    )


SAFE_RANGE = SafeRangeSettings()


class SafeRange(NamedTuple):
    """Thetas that keep the bound.

    Attributes
    ----------
    theta, margin : tuple of float
        Values that were held, rising, and the margin left there; below 0: the bound was broken.
    low, high : float
        Least and largest theta that kept it, without one between that did not.
    bound_low, bound_high : bool
        Whether the constraint and not the rig file ends the range there.
    fixed : bool
        Whether it does so for ever, as a line between knobs, of which no margin is known.
    """

    theta: tuple[float, ...]
    margin: tuple[float, ...]
    low: float
    high: float
    bound_low: bool
    bound_high: bool
    fixed: bool = False

    def ends(self, upper: bool) -> bool:
        """Return whether the constraint ends the range, at its upper or its lower end."""
        return self.bound_high if upper else self.bound_low

    def slope(self, scale: Scale) -> float:
        """Return the steepest change of the margin over u towards the bound; 0: no barrier.

        u is theta or its logarithm, as on the scale. Where the constraint ends the range on both
        sides one slope would be wrong on one of them: the limits alone keep the bound then.
        """
        if self.bound_low == self.bound_high:
            return 0.0
        u, margin = np.array(self.theta), np.array(self.margin)
        if scale.logarithmic:  # what broke the bound may lie beyond 0
            u, margin = np.log(u[u > 0.0]), margin[u > 0.0]
        slopes = np.diff(margin) / np.maximum(np.diff(u), 1e-12)
        return float(min(slopes.min(), 0.0) if self.bound_high else max(slopes.max(), 0.0))

    def margin_at(self, theta: float) -> float:
        """Return the margin that is predicted at a theta."""
        return float(np.interp(theta, self.theta, self.margin))

    def narrow(self, rig: RigFile) -> RigFile:
        """Return the rig file with the limits of theta that keep the bound."""
        start = min(max(rig.theta_start, self.low), self.high)
        return replace(rig, theta_min=self.low, theta_max=self.high, theta_start=start)


class SafeRangeSearch:
    """Chooses where theta is held next, from the margins that were left.

    Parameters
    ----------
    rig : RigFile
        The rig, with a constraint.
    """

    def __init__(self, rig: RigFile) -> None:
        self._scale = rig.scale
        self._begin = float(rig.scale.u(np.array(rig.theta_safe)))
        self._margins: dict[float, float] = {}
        self._sides = [1, -1]

    def next(self) -> float | None:
        """Return the theta that is held next; None once the range is known."""
        if not self._margins:
            return self._scale.theta_at(self._begin)
        while self._sides:
            u = self._beyond(self._sides[0])
            if u is not None:
                return self._scale.theta_at(u)
            self._sides.pop(0)
        return None

    def take(self, theta: float, margin: float) -> None:
        """Take the margin that was left at a theta; below 0: the bound was broken there."""
        self._margins[float(self._scale.u(np.array(theta)))] = margin

    def result(self) -> SafeRange:
        """Return what is known."""
        u = sorted(self._margins)
        scale, (first, last) = self._scale, (self._kept(side)[-1] for side in (-1, 1))
        bound_low, bound_high = first > ROUNDED, last < 1.0 - ROUNDED
        return SafeRange(
            tuple(map(scale.theta_at, u)), tuple(self._margins[v] for v in u),
            scale.theta_at(first) if bound_low else scale.low,
            scale.theta_at(last) if bound_high else scale.high, bound_low, bound_high,
        )  # fmt: skip

    def _kept(self, side: int) -> list[float]:
        """Return the positions on a side that kept the bound, from theta_safe outwards."""
        u = sorted(v for v in self._margins if side * (v - self._begin) >= -ROUNDED)[::side]
        broken = [i for i, v in enumerate(u) if self._margins[v] < 0.0]
        return u[: broken[0]] if broken else u

    def _beyond(self, side: int) -> float | None:
        """Return the next position on a side; None if there is none."""
        s, kept = SAFE_RANGE, self._kept(side)
        if not kept:
            return None
        last, margin = kept[-1], self._margins[kept[-1]]
        limit = 1.0 if side > 0 else 0.0
        broken = [v for v in self._margins if self._margins[v] < 0.0 and side * (v - last) > 0.0]
        way = min([abs(limit - last), *(0.5 * abs(v - last) for v in broken)])
        if margin < s.enough or way < (s.finest if broken else ROUNDED):
            return None
        step = min(s.most, 2.0 * abs(kept[-1] - kept[-2])) if len(kept) > 1 else s.first
        margins = np.array([self._margins[v] for v in kept])
        for left in (margins, -np.log(np.maximum(1.0 - margins, s.slight))):
            falls = (-np.diff(left) / np.abs(np.diff(kept)))[-2:]
            if (steepest := float(max([0.0, *falls]))) > 0.0:
                step = min(step, s.share * left[-1] / steepest)
        if step < s.finest:
            return None
        return last + side * min(step, way)


def forecast(rig: RigFile, window: float) -> tuple[int, float]:
    """Return how many holds there are, and how long they take [s], where the bound is out of reach.

    ``window`` is that of the statistic [s]. Near the bound theta goes by smaller steps.
    """
    search, before, way, holds = SafeRangeSearch(rig), float(rig.theta_safe), 0.0, 0
    while (theta := search.next()) is not None:
        search.take(theta, 1.0)
        holds, way, before = holds + 1, way + abs(theta - before), theta
    way += abs(rig.theta_safe - before)
    return holds, holds * SAFE_RANGE.windows * window + way / rig.theta_rate
