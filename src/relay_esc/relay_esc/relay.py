"""Relay extremum-seeking control (paper section 2.2; Salsbury et al. 2023).

    hp_k    = alpha hp_{k-1} + (1 - alpha) (r_k - r_{k-1}),   alpha = exp(-dt / tau_f)
    epsilon <- -epsilon   if hp_k > 0 and the dwell time has passed since the last flip
    theta_k = clip(theta_{k-1} - k epsilon)

The first sample only primes the filter: r_{-1} is unknown, so its difference is taken as 0 and
theta stays. The same holds for the first sample after a hold, so that a cost that jumped in the
meantime causes no false flip; the filter goes on from where it was.

A cost that follows on no earlier one (another run, another quantity, a long silence) finds the
filter reset. The dwell time then guards it: right after a start its sign is that of the first
difference and says nothing. A controller that joins a run under way holds theta first, until what
the cost did before its time has faded: half of its first turns would be wrong otherwise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from koop_node.arrival import Arrival


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
    largest_change : float
        Largest change of what is given out, per sample [theta]; infinite without a limit.
    settling : int
        Samples for which theta is held after joining a run.
    """

    alpha: float
    step_size: float
    dwell_samples: int
    theta_min: float
    theta_max: float
    sense: float
    largest_change: float
    settling: int


class RelayState(NamedTuple):
    """What the relay remembers between samples.

    Attributes
    ----------
    theta : float
        Last control input that the relay asks for [theta].
    epsilon : int
        Relay sign; +1 moves theta down, -1 up.
    cost_rise_filtered : float
        Filtered cost change, in units of r; positive means that the cost gets worse.
    r_previous : float
        Last cost.
    since_flip : int
        Samples since the last flip; below 0: minus the samples until the controller, which has
        joined a run, begins to seek.
    primed : bool
        False until ``r_previous`` holds a cost to take the next difference from.
    output : float
        Last control input that was given out [theta]; lags behind ``theta`` where that jumps, as
        after a reset, and the rate is limited.
    """

    theta: float
    epsilon: int
    cost_rise_filtered: float
    r_previous: float
    since_flip: int
    primed: bool
    output: float


def dwell_samples(dwell: float, dt: float) -> int:
    """Return the dwell time [s] in samples of ``dt`` [s]: the least n with n dt >= dwell.

    The small slack keeps 0.035 s / 0.005 s at 7 where rounding would make it 8.
    """
    return math.ceil(dwell / dt - 1e-9)


def initial(theta: float, epsilon: int) -> RelayState:
    """Return the state before the first sample; the first flip waits for the dwell time too."""
    return RelayState(float(theta), epsilon, 0.0, 0.0, 0, False, float(theta))


def reset(state: RelayState, theta: float, epsilon: int) -> RelayState:
    """Return to ``theta`` and ``epsilon``; what is given out gets there at its limited rate."""
    return initial(theta, epsilon)._replace(
        since_flip=min(state.since_flip, 0), output=state.output
    )


@njit(cache=True)
def hold(state: RelayState) -> RelayState:
    """Keep theta and the filter; the next cost is not a jump."""
    return RelayState(
        state.theta,
        state.epsilon,
        state.cost_rise_filtered,
        state.r_previous,
        state.since_flip,
        False,
        state.output,
    )


@njit(cache=True)
def restart(state: RelayState, since_flip: int) -> RelayState:
    """Keep theta and its direction; the filter is reset, the dwell time begins."""
    return RelayState(state.theta, state.epsilon, 0.0, 0.0, since_flip, False, state.output)


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
            state.theta,
            state.epsilon,
            state.cost_rise_filtered,
            r,
            state.since_flip,
            True,
            state.output,
        )
    rise = p.alpha * state.cost_rise_filtered + (1.0 - p.alpha) * (p.sense * (r - state.r_previous))
    epsilon = state.epsilon
    since_flip = state.since_flip + 1
    if rise > 0.0 and since_flip >= p.dwell_samples:
        epsilon = -epsilon
        since_flip = 0
    theta = state.theta - p.step_size * epsilon
    theta = min(max(theta, p.theta_min), p.theta_max)
    return RelayState(theta, epsilon, rise, r, since_flip, True, state.output)


@njit(cache=True)
def wait(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Feed the filter with one cost, which may be unusable, while theta is still held."""
    since_flip = state.since_flip + 1
    after = step(p, state, r) if math.isfinite(r) else hold(state)
    return RelayState(
        state.theta,
        state.epsilon,
        after.cost_rise_filtered,
        after.r_previous,
        since_flip,
        after.primed,
        state.output,
    )


@njit(cache=True)
def respond(
    p: RelayParams,
    state: RelayState,
    arrival: int,
    switched: bool,
    settling: bool,
    r: float,
    hold_asked: bool,
) -> tuple[RelayState, bool]:
    """Say what the relay asks for in answer to one cost; see :func:`answer`."""
    if arrival == Arrival.RESTART:
        state = restart(state, 0)
    elif arrival == Arrival.JOIN:
        state = restart(state, -p.settling)
    elif switched:
        state = restart(state, min(state.since_flip, 0))
    elif settling:  # the filter still knows how the cost went before it was lost
        state = RelayState(
            state.theta,
            state.epsilon,
            state.cost_rise_filtered,
            state.r_previous,
            min(state.since_flip, 0),
            False,
            state.output,
        )
    elif arrival == Arrival.RESUME:
        state = restart(state, min(state.since_flip, 0))
    if state.since_flip < 0:
        return wait(p, state, r), True
    if hold_asked or not math.isfinite(r):
        return hold(state), True
    return step(p, state, r), False


@njit(cache=True, inline="always")  # the whole loop is 8 % faster for it
def answer(
    p: RelayParams,
    state: RelayState,
    arrival: int,
    switched: bool,
    settling: bool,
    r: float,
    hold_asked: bool,
) -> tuple[RelayState, bool, bool]:
    """Answer one cost, whatever it is: what the controller does with a message.

    Node, offline loop, study and replay call this. From Python, ``arrival`` must be a plain int:
    numba takes 15 us to recognise an enum.

    Parameters
    ----------
    p : RelayParams
        Parameters.
    state : RelayState
        State after the previous cost.
    arrival : int
        What the cost is to the ones before: an :class:`koop_node.arrival.Arrival` up to JOIN.
    switched : bool
        Whether it is of another quantity than the one before: another kind of cost or model. Its
        difference to the last one then means nothing, and neither does the filter.
    settling : bool
        Whether r is not finite because its own filters have joined a run and not settled.
    r : float
        Cost r_k; theta is held on one that is not finite.
    hold_asked : bool
        Whether the user holds theta, whatever the cost.

    Returns
    -------
    state : RelayState
        State after this cost; ``output`` is the control input to apply.
    holding : bool
        Whether theta was held: no update of the relay.
    saturated : bool
        Whether the control input is at one of its limits.
    """
    usual = (  # nothing to decide and no limit of the rate: apart, the loop is 5 % faster for it
        arrival == Arrival.NEXT
        and not (switched or settling or hold_asked)
        and math.isfinite(r)
        and state.since_flip >= 0
        and state.output == state.theta
        and p.theta_min <= state.theta <= p.theta_max
    )
    if usual:
        state, holding = step(p, state, r), False
        output = state.theta
    else:
        state, holding = respond(p, state, arrival, switched, settling, r, hold_asked)
        output = slew(state.output, state.theta, p.largest_change)
    state = RelayState(
        state.theta,
        state.epsilon,
        state.cost_rise_filtered,
        state.r_previous,
        state.since_flip,
        state.primed,
        output,
    )
    return state, holding, output <= p.theta_min or output >= p.theta_max


@njit(cache=True)
def slew(theta: float, wanted: float, most: float) -> float:
    """Return ``wanted``, or as far from ``theta`` towards it as a change of ``most`` allows."""
    return min(max(wanted, theta - most), theta + most)
