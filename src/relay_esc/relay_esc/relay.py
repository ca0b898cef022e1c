"""Relay extremum-seeking control (paper section 2.2; Salsbury et al. 2023).

    hp_k    = alpha hp_{k-1} + (1 - alpha) (r_k - r_{k-1}),   alpha = exp(-dt / tau_f)
    epsilon <- -epsilon   if hp_k > 0 and the dwell time has passed since the last flip
    theta_k = clip(theta_{k-1} - k epsilon)

The first sample only primes the filter: r_{-1} is unknown, so its difference is taken as 0 and
theta stays. The same holds for the first sample after a hold, so that a cost that jumped in the
meantime causes no false flip; the filter goes on from where it was. After a cost that follows on no
earlier one the filter starts from nothing. It then has the dwell time to settle: right after a
start, its sign is that of the first difference and says nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit


class RelayParams(NamedTuple):
    """Scalars of the kernel.

    Attributes
    ----------
    alpha : float
        Filter coefficient exp(-dt / tau_f) [-].
    step_size : float
        Change of theta per sample, k > 0 [theta].
    dwell_samples : int
        Samples that must lie between two flips, dwell time / dt.
    theta_min, theta_max : float
        Saturation limits [theta].
    sense : float
        +1 minimises r, -1 maximises it.
    """

    alpha: float
    step_size: float
    dwell_samples: int
    theta_min: float
    theta_max: float
    sense: float


class RelayState(NamedTuple):
    """What the relay remembers between samples.

    Attributes
    ----------
    theta : float
        Last control input [theta].
    epsilon : int
        Relay sign; +1 moves theta down, -1 up.
    cost_rise_filtered : float
        Filtered cost change, in units of r; positive means that the cost gets worse.
    r_previous : float
        Last cost.
    since_flip : int
        Samples since the last flip.
    primed : bool
        False until ``r_previous`` holds a cost to take the next difference from.
    """

    theta: float
    epsilon: int
    cost_rise_filtered: float
    r_previous: float
    since_flip: int
    primed: bool


def dwell_samples(dwell: float, dt: float) -> int:
    """Return the dwell time [s] in samples of ``dt`` [s]: the least n with n dt >= dwell.

    The small slack keeps 0.035 s / 0.005 s at 7 where rounding would make it 8.
    """
    return math.ceil(dwell / dt - 1e-9)


def initial(theta: float, epsilon: int) -> RelayState:
    """Return the state before the first sample; the first flip waits for the dwell time too."""
    return RelayState(float(theta), epsilon, 0.0, 0.0, 0, False)


@njit(cache=True)
def hold(state: RelayState) -> RelayState:
    """Keep theta and the filter; the next cost is no jump."""
    return RelayState(
        state.theta,
        state.epsilon,
        state.cost_rise_filtered,
        state.r_previous,
        state.since_flip,
        False,
    )


@njit(cache=True)
def anew(state: RelayState) -> RelayState:
    """Keep theta and its direction; filter and dwell time start from nothing."""
    return RelayState(state.theta, state.epsilon, 0.0, 0.0, 0, False)


@njit(cache=True)
def step(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Process one cost sample.

    Parameters
    ----------
    p : RelayParams
        Parameters.
    state : RelayState
        State after the previous sample.
    r : float
        Cost r_k; must be finite (the caller holds on anything else).

    Returns
    -------
    RelayState
        State after this sample; ``theta`` is the control input to apply.
    """
    if not state.primed:
        return RelayState(
            state.theta, state.epsilon, state.cost_rise_filtered, r, state.since_flip, True
        )
    cost_rise_filtered = p.alpha * state.cost_rise_filtered + (1.0 - p.alpha) * (
        p.sense * (r - state.r_previous)
    )
    epsilon = state.epsilon
    since_flip = state.since_flip + 1
    if cost_rise_filtered > 0.0 and since_flip >= p.dwell_samples:
        epsilon = -epsilon
        since_flip = 0
    theta = state.theta - p.step_size * epsilon
    theta = min(max(theta, p.theta_min), p.theta_max)
    return RelayState(theta, epsilon, cost_rise_filtered, r, since_flip, True)


@njit(cache=True)
def respond(
    p: RelayParams, state: RelayState, r: float, from_nothing: bool, hold_asked: bool
) -> tuple[RelayState, bool]:
    """Answer one cost, whatever it is: the node and the offline replay decide alike.

    Parameters
    ----------
    p : RelayParams
        Parameters.
    state : RelayState
        State after the previous cost.
    r : float
        Cost r_k; theta is held on one that is not finite.
    from_nothing : bool
        Whether r_k follows on no earlier cost: another run, another quantity, a long silence. Its
        difference to the last one then means nothing.
    hold_asked : bool
        Whether theta is to be held whatever the cost.

    Returns
    -------
    state : RelayState
        State after this cost; ``theta`` is the control input to apply.
    holding : bool
        Whether theta was held.
    """
    if from_nothing:
        state = anew(state)
    if hold_asked or not math.isfinite(r):
        return hold(state), True
    return step(p, state, r), False


@njit(cache=True)
def slew(theta: float, wanted: float, most: float) -> float:
    """Return ``wanted``, or as far from ``theta`` towards it as a change of ``most`` allows."""
    return min(max(wanted, theta - most), theta + most)


@njit(cache=True)
def saturated(p: RelayParams, theta: float) -> bool:
    """Return True if ``theta`` is at one of its limits."""
    return theta <= p.theta_min or theta >= p.theta_max
