"""The margin of a constraint: how far the statistic s of a second signal v is from its bound.

    margin_k = 1 - s_k / bound

    rms:   s_k^2 = s_{k-1}^2 + w (v_k^2 - s_{k-1}^2),   w = 1 - exp(-m dt / window)
    peak:  s_k = the largest |v| of this window and of the one before it

v_k is of the values since the sample of the state before: their rms or their largest |v|. They
count for m samples, as many as bring so many values in the mean of the last window: states and
values that come in bursts, all of one before those of the other, weigh as if they had alternated.
Where none came the statistic stays as it is.

Until a window has passed after a start or a join there is no margin (NaN), nor is there where the
signal, or its square, is not finite, or it was silent for a window. The first samples of an rms all
count alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from koop_core.config.constraint import Constraint
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival


class MarginParams(NamedTuple):
    """Scalars of the statistic."""

    peak: bool
    """Whether the statistic is the peak."""
    window: int
    """Samples of the window."""
    rate: float
    """dt / window [-]."""
    bound: float
    """What the statistic must stay below, in the signal's unit."""


class MarginState(NamedTuple):
    """State of the signal's statistic."""

    samples: float
    """Samples that values counted for; of a peak, samples of the state in this window."""
    now: float
    """s^2; of a peak, the largest magnitude in this window."""
    before: float
    """Largest magnitude in the window before; below 0: there was none."""


BEGIN = MarginState(0.0, 0.0, -1.0)


def margin_params(constraint: Constraint, dt: float) -> MarginParams:
    """Return the scalars for a sampling time [s]."""
    samples = max(1, math.ceil(constraint.window / dt - 1e-9))
    peak, rate = constraint.statistic == "peak", dt / constraint.window
    return MarginParams(peak, samples, rate, constraint.bound)


@njit()
def follow(
    p: MarginParams, state: MarginState, arrival: int, v: float, m: float
) -> tuple[float, MarginState]:
    """Return the margin after one sample of the state, NaN where there is none, and the state.

    ``arrival`` is what the sample is to the ones before, up to JOIN; after a start or a join
    nothing is known. ``v`` is the signal since the sample before, which counts for ``m`` samples;
    0: no value came.
    """
    if arrival == Arrival.RESTART or arrival == Arrival.JOIN or not math.isfinite(v * v):
        state = BEGIN
    if not math.isfinite(v * v):
        return math.nan, state
    if p.peak:
        samples, now, before = state.samples + 1.0, max(state.now, abs(v)), state.before
        margin = 1.0 - max(now, before) / p.bound if before >= 0.0 else math.nan
        if samples >= p.window:
            return margin, MarginState(0.0, 0.0, now)
        return margin, MarginState(samples, now, before)
    samples, now = state.samples + m, state.now
    if m > 0.0:
        now += max(-math.expm1(-m * p.rate), m / samples) * (v * v - now)
    margin = 1.0 - math.sqrt(now) / p.bound if samples >= p.window else math.nan
    return margin, MarginState(min(samples, float(p.window)), now, -1.0)


class SignalMeter:
    """Sums of a signal between two samples of the state, ``dt`` [s] apart."""

    def __init__(self, constraint: Constraint, dt: float) -> None:
        self._peak = constraint.statistic == "peak"
        self._longest = max(1, math.ceil(constraint.window / dt))
        self._count, self._sum, self._most = 0, 0.0, 0.0
        self._silent = self._longest  # samples of the state
        self._taken, self._rate = 0, 0.0  # samples of the state, and values of each

    def hear(self, value: float) -> None:
        """Take a value of the signal."""
        self._count += 1
        self._sum += value * value
        self._most = max(self._most, abs(value)) if value == value else math.nan

    def take(self) -> tuple[float, float]:
        """Return the signal since the last sample of the state, and for how many it counts.

        Both are 0 where no value came; the signal is NaN once that was so for a window.
        """
        count, total, most = self._count, self._sum, self._most
        self._count, self._sum, self._most = 0, 0.0, 0.0
        if self._silent >= self._longest:
            self._taken, self._rate = 0, 0.0
        self._taken = min(self._taken + 1, self._longest)
        self._rate += (count - self._rate) / self._taken
        if not count:
            self._silent += 1
            return (0.0 if self._silent < self._longest else math.nan), 0.0
        self._silent = 0
        return (most if self._peak else math.sqrt(total / count)), count / self._rate
