"""A bound that theta keeps: a barrier around the relay (after Williams, Krstic and Scheinker 2024).

What the relay asks for is changed as little as a margin h asks for, of which the bound is h = 0:

    h' u' >= -c low,   c = 1 / dwell,   low = mean(h) - z dev(h)

h' is the margin's slope over u, as an excitation has shown it; mean and dev are of the margin over
the last half dwell time and eight dwell times, dev is the mean absolute deviation. Inside the bound
the relay is free, at it u stops, beyond it u goes back. While the barrier holds u back the relay
does not turn away but goes on to the bound, unless the cost's level is worse than where the leg
began: each swing inwards would cost, and tell nothing that is not known. Without a margin (NaN)
theta is held.

The published law descends the cost's estimated gradient and projects it with the estimated gradient
of the margin (arXiv 2309.15401, 2404.08842); here the relay takes the place of the descent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from koop_core.config.parameter import Settings, constants, parameter
from koop_core.kernels import njit
from koop_core.named_tuple import replace
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState
from relay_esc.swing import gain

studied = partial(parameter, low=0.1, origin="random rigs with a constraint, commit 17fad32")


@dataclass(frozen=True)
class BarrierSettings(Settings):
    """How the margin that the barrier keeps is taken from the margins that are told."""

    mean: float = studied(0.5, "time constant of the margin's mean", unit="dwell")
    deviation: float = studied(8.0, "time constant of its mean absolute deviation", unit="dwell")
    deviations: float = studied(3.0, "z, deviations below the mean that are kept inside")


BARRIER = constants(BarrierSettings())


class BarrierParams(NamedTuple):
    """Scalars of the barrier."""

    slope: float
    """h', change of the margin over u; 0: there is no bound."""
    dwell_samples: int
    """Dwell time in samples, at least 1."""
    alpha_mean: float
    alpha_deviation: float
    """Filter coefficients [-]."""


class BarrierState(NamedTuple):
    """State of the barrier."""

    mean: float
    deviation: float
    """Mean and mean absolute deviation of the margin."""
    known: bool
    """Whether there was a margin before."""


UNKNOWN = BarrierState(0.0, 0.0, False)


def barrier_params(slope: float, dwell_samples: int) -> BarrierParams:
    """Return the scalars for a slope [1/u] and a dwell time in samples."""
    n = max(dwell_samples, 1)
    return BarrierParams(
        slope, n, *(math.exp(-1.0 / (a * n)) for a in (BARRIER.mean, BARRIER.deviation))
    )


@njit(inline="always")
def answer(
    p: RelayParams,
    q: BarrierParams,
    state: RelayState,
    barrier: BarrierState,
    arrival: int,
    switched: bool,
    settling: bool,
    r: float,
    hold_asked: bool,
    margin: float,
) -> tuple[RelayState, BarrierState, bool, bool]:
    """Answer one cost as :func:`relay_esc.relay.answer` does, within the bound.

    Without a slope in ``q`` this is the relay alone. ``margin`` is the share of the bound that is
    left, NaN where it is not known. Returns state, barrier, holding and saturated after this cost.
    """
    bounded = q.slope != 0.0
    hold_asked = hold_asked or (bounded and not math.isfinite(margin))
    before = state
    state, holding, saturated = relay.answer(p, state, arrival, switched, settling, r, hold_asked)
    if not bounded:
        return state, barrier, holding, saturated
    barrier = follow(q, barrier, margin)
    if holding:
        return state, barrier, holding, saturated
    low = barrier.mean - BARRIER.deviations * barrier.deviation
    most = max(low / (q.dwell_samples * abs(q.slope)), -p.step_size)  # towards the bound
    out = -1.0 if q.slope > 0.0 else 1.0
    step = p.step_size * gain(before.swing, before.u, before.epsilon)
    rises = before.swing.level > before.swing.begin  # the cost is worse than where the leg began
    stays = before.epsilon == -out and most < step and not rises
    if stays and state.epsilon != before.epsilon:  # the relay would turn away
        u = before.u + out * most
        state = relay.take(p, before, r)
    else:
        u = before.u + out * min(out * (state.u - before.u), most)
    u = min(max(u, relay.lowest(p, state.swing)), relay.highest(p, state.swing))
    state = replace(state, u=u)
    state = relay.command(p, state, relay.slew(before.commanded, u, p.largest_change))
    return state, barrier, False, relay.at_limit(p, state)


@njit(inline="always")
def follow(q: BarrierParams, state: BarrierState, margin: float) -> BarrierState:
    """Take a margin into mean and deviation; NaN: nothing is known any more."""
    if not math.isfinite(margin):
        return BarrierState(0.0, 0.0, False)
    if not state.known:
        return BarrierState(margin, 0.0, True)
    mean = margin + q.alpha_mean * (state.mean - margin)
    distance = abs(margin - mean)
    return BarrierState(mean, distance + q.alpha_deviation * (state.deviation - distance), True)
