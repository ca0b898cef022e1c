"""Relay extremum-seeking control (paper section 2.2; Salsbury et al. 2023).

    hp_k    = alpha hp_{k-1} + (1 - alpha) (x_k - x_{k-1}),   alpha = exp(-dt / tau_f)
    epsilon <- -epsilon   if hp_k > 0 and the dwell time has passed since the last flip
    u_k     = clip(u_{k-1} - k g epsilon)

The law ``relay`` is the paper's: x = r and g = 1. The law ``adaptive`` takes x = log r, though a
wide leg turns where r rises; g, the dwell time and what is wide are :mod:`relay_esc.swing`'s. A
cost of 0 is unusable for it. The control input is theta = u, or theta = exp(u) with
``theta_scale: log``.

The first sample only primes the filter: its difference is taken as 0 and theta stays. So it is for
the first sample after a hold; the filter goes on from where it was. A cost that follows on no
earlier one (another run, another quantity, a long silence) finds the filter reset, and the dwell
time begins. A controller that joins a run under way holds theta first, until what the cost did
before its time has faded: half of its first turns would be wrong otherwise. So does one that goes
on where an earlier one was (:func:`recalled`); it has theta, its direction and the swing.

Theta that is outside its limits, as where they were narrowed or the rig starts beyond them, goes to
the nearer one at its limited rate, and the relay waits there.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

from koop_core.kernels import njit
from koop_core.named_tuple import replace
from koop_core.stream.arrival import Arrival
from relay_esc.elementary import exp, log
from relay_esc.swing import (
    OPEN,
    SWING,
    Swing,
    confidence,
    follow,
    forget_leg,
    gain,
    is_lost,
    open_limits,
    turn,
    widen,
)

LARGEST = sys.float_info.max
LASTING = {
    "factor": float, "stretch": float, "lowest_before": float, "reference": float, "noise": float,
    "dip": float, "legs": int, "turned": float, "centre": float, "centred": int, "below": float,
    "beyond": float, "calm": float,
}  # fmt: skip
"""Fields of the swing that outlast a leg."""
MEMORY = 2 + len(LASTING)  # numbers of :func:`memory`


class RelayParams(NamedTuple):
    """Scalars of the kernel."""

    alpha: float
    """Filter coefficient exp(-dt / tau_f) [-]."""
    step_size: float
    """Change of u per sample, k > 0 [u]."""
    dwell_samples: int
    """Samples that must lie between two flips, dwell time / dt."""
    u_min: float
    u_max: float
    """Saturation limits [u], the widest."""
    u_low: float
    u_high: float
    """Those that theta keeps while the optimum is not lost."""
    sense: float
    """+1 minimises r, -1 maximises it."""
    largest_change: float
    """Largest change of what is given out, per sample [u]; infinite without a limit."""
    settling: int
    """Samples for which theta is held after joining a run."""
    adaptive: bool
    """Whether the law is ``adaptive``."""
    alpha_level: float
    """Filter coefficient of the level of log r [-]."""
    step_ratio: float
    """Smallest step in units of ``step_size``."""
    logarithmic: bool
    """Whether theta = exp(u)."""
    theta_min: float
    theta_max: float
    theta_low: float
    theta_high: float
    """All four limits [theta]."""


class RelayState(NamedTuple):
    """State of the relay between samples."""

    u: float
    """What the relay asks for [u]: theta, or its logarithm."""
    epsilon: int
    """Relay sign; +1 moves theta down, -1 up."""
    cost_rise_filtered: float
    """Filtered change of x; positive means that the cost gets worse."""
    x_previous: float
    """Last cost, or its logarithm."""
    since_flip: int
    """Samples since the last flip; below 0: minus the samples until the controller, which has
    joined a run, begins to seek."""
    primed: bool
    """False until ``x_previous`` holds a cost to take the next difference from."""
    commanded: float
    """What was given out last [u]; lags behind ``u`` where that jumps, as after a reset, and the
    rate is limited."""
    output: float
    """Control input that was given out last [theta]."""
    swing: Swing
    """State of the adaptive law."""


def dwell_samples(dwell: float, dt: float) -> int:
    """Return the dwell time [s] in samples of ``dt`` [s]: the least n with n dt >= dwell.

    The small slack keeps 0.035 s / 0.005 s at 7 where rounding would make it 8.
    """
    return math.ceil(dwell / dt - 1e-9)


def initial(u: float, epsilon: int, theta: float) -> RelayState:
    """Return the state before the first sample; the first flip waits for the dwell time too."""
    return RelayState(float(u), epsilon, 0.0, 0.0, 0, False, float(u), float(theta), OPEN)


def memory(state: RelayState) -> tuple[float, ...]:
    """Return what a controller goes on from after its end: u, epsilon and the swing, less a leg."""
    lasting = (getattr(state.swing, name) for name in LASTING)
    return (state.u, *map(float, (state.epsilon, *lasting)))


def recalled(begin: RelayState, numbers: Sequence[float]) -> RelayState:
    """Return the state ``begin`` with what :func:`memory` has kept; it waits to join a run."""
    u, epsilon, *values = numbers
    kept = (kind(value) for kind, value in zip(LASTING.values(), values, strict=True))
    swing = OPEN._replace(**dict(zip(LASTING, kept, strict=True)))
    return begin._replace(u=u, epsilon=int(epsilon), since_flip=-1, commanded=u, swing=swing)


def reset(state: RelayState, begin: RelayState) -> RelayState:
    """Return to the state ``begin``; what is given out gets there at its limited rate."""
    return begin._replace(
        since_flip=min(state.since_flip, 0), commanded=state.commanded, output=state.output
    )


@njit()
def insight(p: RelayParams, state: RelayState) -> tuple[float, float, float]:
    """Return gradient, noise and confidence: what the controller knows besides what it answers.

    The gradient is the slope of the cost over u, of log r with the adaptive law; filtered as the
    rise is. It is the cost's change over theta's step, whatever causes the change. Noise and
    confidence belong to the adaptive law; NaN with the relay, which has none.
    """
    step_size = p.step_size * gain(state.swing, state.u, state.epsilon)
    gradient = 0.0
    if step_size != 0.0:
        gradient = -p.sense * state.epsilon * state.cost_rise_filtered / step_size
    if not p.adaptive:
        return gradient, math.nan, math.nan
    return gradient, state.swing.noise, confidence(state.swing)


@njit()
def hold(state: RelayState) -> RelayState:
    """Keep theta and the filter; the next cost is not a jump."""
    return replace(state, primed=False)


@njit()
def restart(state: RelayState, since_flip: int, swing: Swing) -> RelayState:
    """Keep theta and its direction; the filter is reset, the dwell time begins."""
    return replace(
        state, cost_rise_filtered=0.0, x_previous=0.0, since_flip=since_flip, primed=False,
        swing=swing,
    )  # fmt: skip


@njit(inline="always")
def take(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Take a usable cost into the filters; theta and the time since the flip stay."""
    swing = state.swing
    if p.adaptive:
        x = log(r)
        cost = r if p.sense > 0.0 else min(1.0 / r, LARGEST)
        swing = follow(swing, p.alpha_level, p.sense * x, p.alpha, cost, state.primed)
    else:
        x = r
    rise = state.cost_rise_filtered
    if state.primed:
        rise = p.alpha * rise + (1.0 - p.alpha) * (p.sense * (x - state.x_previous))
    return replace(state, cost_rise_filtered=rise, x_previous=x, primed=True, swing=swing)


@njit(inline="always")
def step(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Process one usable cost; ``u`` of the state after it is the control input to apply."""
    after = take(p, state, r)
    if not state.primed:
        return after
    epsilon = state.epsilon
    since_flip = state.since_flip + 1
    swing = after.swing
    wide = p.adaptive and swing.factor >= SWING.wide
    rise = swing.rise if wide else after.cost_rise_filtered
    if rise > 0.0 and since_flip >= p.dwell_samples * swing.stretch:
        epsilon = -epsilon
        if p.adaptive:
            length = since_flip / max(p.dwell_samples, 1)
            ends = (swing.turned, state.u)
            inside = p.u_low <= min(ends) and max(ends) <= p.u_high
            swing = turn(swing, length, state.u, p.step_ratio, inside)
        since_flip = 0
    elif p.adaptive and since_flip >= 2 * p.dwell_samples > 0 and since_flip % p.dwell_samples == 0:
        swing = widen(swing)
    u = state.u - p.step_size * gain(swing, state.u, epsilon) * epsilon
    u = min(max(u, p.u_min), p.u_max)
    if p.adaptive and not p.u_low <= u <= p.u_high and is_lost(swing, since_flip, p.dwell_samples):
        swing = open_limits(swing, p.u_low - u, u - p.u_high)
    u = min(max(u, lowest(p, swing)), highest(p, swing))
    return replace(after, u=u, epsilon=epsilon, since_flip=since_flip, swing=swing)


@njit()
def usable(p: RelayParams, r: float) -> bool:
    """Return whether a cost is usable; 0 has no logarithm."""
    return math.isfinite(r) and (r > 0.0 or not p.adaptive)


@njit()
def wait(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Feed the filter with one cost, which may be unusable, while theta is still held."""
    after = take(p, state, r) if usable(p, r) else hold(state)
    return replace(after, since_flip=state.since_flip + 1)


@njit()
def outside(p: RelayParams, state: RelayState) -> bool:
    """Return whether theta has yet to reach its limits."""
    return not lowest(p, state.swing) <= state.commanded <= highest(p, state.swing)


@njit(inline="always")
def lowest(p: RelayParams, swing: Swing) -> float:
    """Return the least u, as far as the limit is open."""
    return max(p.u_low - swing.below, p.u_min)


@njit(inline="always")
def highest(p: RelayParams, swing: Swing) -> float:
    """Return the largest u, as far as the limit is open."""
    return min(p.u_high + swing.beyond, p.u_max)


@njit()
def enter(p: RelayParams, state: RelayState, r: float) -> RelayState:
    """Feed the filter while theta is on its way to its limits."""
    after = wait(p, state, r)
    u = min(max(state.u, lowest(p, state.swing)), highest(p, state.swing))
    return replace(after, u=u, since_flip=min(after.since_flip, 0))


@njit()
def respond(
    p: RelayParams,
    state: RelayState,
    arrival: int,
    switched: bool,
    settling: bool,
    r: float,
    hold_asked: bool,
) -> tuple[RelayState, bool]:
    """Return what the relay asks for in answer to one cost; see :func:`answer`."""
    if arrival == Arrival.RESTART:
        state = restart(state, 0, OPEN)
    elif arrival == Arrival.JOIN:  # a controller that goes on where another was knows the swing
        swing = forget_leg(state.swing) if state.since_flip < 0 else OPEN
        state = restart(state, -p.settling, swing)
    elif switched:
        state = restart(state, min(state.since_flip, 0), OPEN)
    elif settling:  # the filter still knows how the cost went before it was lost
        state = replace(state, since_flip=min(state.since_flip, 0), primed=False)
    elif arrival == Arrival.RESUME:
        state = restart(state, min(state.since_flip, 0), forget_leg(state.swing))
    if outside(p, state) and not hold_asked:
        return enter(p, state, r), True
    if state.since_flip < 0:
        return wait(p, state, r), True
    if hold_asked or not usable(p, r):
        return hold(state), True
    return step(p, state, r), False


@njit(inline="always")  # the whole loop is 8 % faster for it
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
        What the cost is to the ones before: a
        :class:`koop_core.stream.arrival.Arrival` up to JOIN.
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
        and usable(p, r)
        and state.since_flip >= 0
        and state.commanded == state.u
        and lowest(p, state.swing) <= state.u <= highest(p, state.swing)
    )
    if usual:
        state, holding = step(p, state, r), False
        commanded = state.u
    else:
        state, holding = respond(p, state, arrival, switched, settling, r, hold_asked)
        commanded = slew(state.commanded, state.u, p.largest_change)
    state = command(p, state, commanded)
    return state, holding, at_limit(p, state)


@njit(inline="always")
def command(p: RelayParams, state: RelayState, commanded: float) -> RelayState:
    """Give out a control input [u]."""
    output = theta_of(p, commanded) if p.logarithmic else commanded
    return replace(state, commanded=commanded, output=output)


@njit(inline="always")
def at_limit(p: RelayParams, state: RelayState) -> bool:
    """Return whether the control input is at one of its limits."""
    return not lowest(p, state.swing) < state.commanded < highest(p, state.swing)


@njit()
def theta_of(p: RelayParams, u: float) -> float:
    """Return theta = exp(u); at a limit that limit itself, and never beyond one by rounding."""
    if u == p.u_low:
        return p.theta_low
    if u == p.u_high:
        return p.theta_high
    theta = exp(u)
    if p.u_min <= u <= p.u_max:
        theta = min(max(theta, p.theta_min), p.theta_max)
    return theta


@njit()
def slew(theta: float, wanted: float, most: float) -> float:
    """Return ``wanted``, or as far from ``theta`` towards it as a change of ``most`` allows."""
    return min(max(wanted, theta - most), theta + most)
