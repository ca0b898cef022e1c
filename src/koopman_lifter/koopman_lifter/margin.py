"""The margin of a constraint: how far the statistic s of a second signal v is from its bound.

    margin_k = 1 - s_k / bound

    rms:   s_k^2 = s_{k-1}^2 + w (v_k^2 - s_{k-1}^2),   w = 1 - exp(-dt / window)
    peak:  s_k = the largest |v| of this window and of the one before it

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
    weight: float
    """w, of one sample in the rms [-]."""
    bound: float
    """What the statistic must stay below, in the signal's unit."""


class MarginState(NamedTuple):
    """State of the signal's statistic."""

    samples: int
    """Samples in all; of a peak, in this window."""
    now: float
    """s^2; of a peak, the largest magnitude in this window."""
    before: float
    """Largest magnitude in the window before; below 0: there was none."""


BEGIN = MarginState(0, 0.0, -1.0)


def margin_params(constraint: Constraint, dt: float) -> MarginParams:
    """Return the scalars for a sampling time [s]."""
    samples = max(1, math.ceil(constraint.window / dt - 1e-9))
    weight = -math.expm1(-dt / constraint.window)
    return MarginParams(constraint.statistic == "peak", samples, weight, constraint.bound)


@njit()
def follow(
    p: MarginParams, state: MarginState, arrival: int, v: float
) -> tuple[float, MarginState]:
    """Return the margin after one sample of the signal, NaN where there is none, and the state.

    ``arrival`` is what the sample is to the ones before, up to JOIN; after a start or a join
    nothing is known.
    """
    if arrival == Arrival.RESTART or arrival == Arrival.JOIN or not math.isfinite(v * v):
        state = BEGIN
    if not math.isfinite(v * v):
        return math.nan, state
    samples = state.samples + 1
    if p.peak:
        now, before = max(state.now, abs(v)), state.before
        margin = 1.0 - max(now, before) / p.bound if before >= 0.0 else math.nan
        if samples >= p.window:
            return margin, MarginState(0, 0.0, now)
        return margin, MarginState(samples, now, before)
    now = state.now + max(p.weight, 1.0 / samples) * (v * v - state.now)
    margin = 1.0 - math.sqrt(now) / p.bound if samples >= p.window else math.nan
    return margin, MarginState(min(samples, p.window), now, -1.0)


class SignalMeter:
    """Sums of a signal between two samples of the state, ``dt`` [s] apart."""

    def __init__(self, constraint: Constraint, dt: float) -> None:
        self._peak = constraint.statistic == "peak"
        self._longest = max(1, math.ceil(constraint.window / dt))
        self._last = math.nan
        self._count, self._sum, self._most = 0, 0.0, 0.0
        self._silent = 0  # samples of the state

    def hear(self, value: float) -> None:
        """Take a value of the signal."""
        self._last, self._count = value, self._count + 1
        self._sum += value * value
        self._most = max(self._most, abs(value)) if value == value else math.nan

    def take(self) -> float:
        """Return the signal for the next sample of the state; the last value where none came."""
        count, total, most = self._count, self._sum, self._most
        self._count, self._sum, self._most = 0, 0.0, 0.0
        if not count:
            self._silent += 1
            return self._last if self._silent < self._longest else math.nan
        self._silent = 0
        return most if self._peak else math.sqrt(total / count)
