"""A relay with hysteresis and adaptive step, a baseline for the paper's relay.

    u_k  = alpha u_{k-1} + alpha (r_k - r_{k-1})        rise of the cost above its moving average
    flip if u_k > h r_k and the dwell time has passed
    at a flip: step <- max(shrink * step, step_min) if the last leg was short, as in a cycle around
    the optimum; while a leg is long: step grows back to step_max, as when the optimum has moved

The paper's relay flips on any rise; the hysteresis h asks for a relative one. Its cycle around the
optimum is as wide as a dwell time times the step, so shrinking the step narrows the cycle.

It stays for the rows of the experiment ``beyond`` that the published study shows, and for nothing
else: a step that shrinks with every short leg and grows by the clock has a 90th percentile of 3300
there. The law ``adaptive`` of the node (:mod:`relay_esc.swing`) is what came of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from koop_core.config.parameter import parameter, validate
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from relay_esc.config import EscConfig
from relay_esc.relay import dwell_samples


class AdaptiveParams(NamedTuple):
    """Scalars of the kernel, see :class:`AdaptiveConfig`; durations in samples."""

    alpha: float
    step_max: float
    step_min: float
    shrink: float
    growth: float
    hysteresis: float
    dwell_samples: int
    short_leg: int
    theta_min: float
    theta_max: float


class AdaptiveState(NamedTuple):
    """What the controller remembers: theta, direction, step, filter and samples since a flip."""

    theta: float
    epsilon: int
    step: float
    rise: float
    r_previous: float
    since_flip: int
    primed: bool


@dataclass(frozen=True)
class AdaptiveConfig:
    """What the adaptive relay has beyond :class:`relay_esc.config.EscConfig`."""

    hysteresis: float = parameter(
        0.0, "relative rise of the cost that causes a flip", low=0.0, high=10.0
    )
    shrink: float = parameter(
        0.7, "factor on the step at a flip after a short leg", low=0.05, high=1.0
    )
    step_ratio: float = parameter(0.2, "smallest step relative to the relay's", low=0.001, high=1.0)
    growth_time: float = parameter(
        20.0, "time in which the step grows e-fold on a long leg", unit="s", low=0.1, high=1e4
    )
    short_leg: float = parameter(
        2.0, "a leg up to this many dwell times is short", low=1.0, high=100.0
    )

    def __post_init__(self) -> None:
        validate(self)

    def params(self, esc: EscConfig) -> AdaptiveParams:
        """Return the values that :func:`step` takes."""
        dwell = dwell_samples(esc.dwell, esc.dt)
        return AdaptiveParams(
            math.exp(-esc.dt / esc.tau_f),
            _step(esc),
            _step(esc) * self.step_ratio,
            self.shrink,
            math.exp(esc.dt / self.growth_time),
            self.hysteresis,
            dwell,
            round(self.short_leg * dwell),
            esc.theta_min,
            esc.theta_max,
        )


def initial(esc: EscConfig) -> AdaptiveState:
    """Return the state before the first sample: full step."""
    return AdaptiveState(esc.theta_initial, esc.epsilon_initial, _step(esc), 0.0, 0.0, 0, False)


def _step(esc: EscConfig) -> float:
    return min(esc.step_size, esc.largest_change)


@njit()
def step(p: AdaptiveParams, state: AdaptiveState, r: float) -> AdaptiveState:
    """Process one cost sample; ``theta`` of the returned state is the control input."""
    if not state.primed:
        return AdaptiveState(state.theta, state.epsilon, state.step, 0.0, r, state.since_flip, True)
    rise = p.alpha * (state.rise + r - state.r_previous)
    epsilon = state.epsilon
    size = state.step
    since_flip = state.since_flip + 1
    if since_flip > p.short_leg:
        size = min(size * p.growth, p.step_max)
    if rise > p.hysteresis * r and rise > 0.0 and since_flip >= p.dwell_samples:
        if since_flip <= p.short_leg:
            size = max(size * p.shrink, p.step_min)
        epsilon = -epsilon
        since_flip = 0
    theta = min(max(state.theta - size * epsilon, p.theta_min), p.theta_max)
    return AdaptiveState(theta, epsilon, size, rise, r, since_flip, True)


@njit()
def answer(p: AdaptiveParams, state: AdaptiveState, arrival: int, r: float) -> AdaptiveState:
    """Answer one cost, whatever it is; hold where there is none, as the paper's relay does.

    After a silence or a hold the next cost is no rise: it only starts the moving average.
    """
    usable = math.isfinite(r)
    if not usable or arrival != Arrival.NEXT:
        state = AdaptiveState(
            state.theta,
            state.epsilon,
            state.step,
            state.rise,
            state.r_previous,
            state.since_flip,
            False,
        )
    return step(p, state, r) if usable else state
