"""Several knobs: the relay seeks along one direction after another.

    u = base + s scale d,   s the control input of the relay of :mod:`relay_esc.relay`

d is a unit vector in units of each knob's ``scale``. After :attr:`DirectionSettings.legs` legs u
goes to the middle of what the relay has swept, there the next direction begins: a knob that rests
where its last leg ended, at the edge of its swing, would add to the cost as much as the one that
seeks. The cost's level and its noise are known to all directions, each has its swing.

After a round of n directions, the way that base went in it takes the place of the direction that is
most like it, and the others are made orthogonal to it again (Rosenbrock 1960): knobs that are
coupled are sought along their valley. A round that went nowhere says nothing and changes nothing.

Lines between knobs (:mod:`koop_core.config.constraint`) are kept as their limits are: u is brought
back to them by the shortest way, in units of ``scale``, and so goes along a line to the best on it.
What is given out then moves straight, the slowest knob at its rate: what a way's ends keep it keeps
all along.

With one knob this is the relay alone, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError, Settings, constants, parameter
from koop_core.kernels import njit
from koop_core.named_tuple import replace
from relay_esc import relay
from relay_esc.elementary import exp
from relay_esc.relay import MEMORY, RelayParams, RelayState, initial, slew
from relay_esc.swing import SWING, Swing

judged = partial(parameter, origin="koop study knobs")


@dataclass(frozen=True)
class DirectionSettings(Settings):
    """When the direction changes."""

    legs: int = judged(3, "legs along a direction; an odd number alternates its sense", low=1)
    progress: float = judged(
        0.5, "least way of a round that becomes a direction", unit="swing", low=0.0
    )


DIRECTIONS = constants(DirectionSettings())
FACTOR, DIP, SHORT, CENTRED, EPSILON = range(5)
OWN = 5  # numbers that a direction has of its own
ROUNDED = 1e-10  # share of a line's terms that counts as none
SWEEPS = 2000  # of :func:`bring_inside`: a line that is nearly along a limit takes hundreds
LASTING = ("base", "begin", "output", "directions", "own")  # arrays that outlast the controller


class Knobs(NamedTuple):
    """Limits of the knobs; arrays of shape (n,)."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    """Saturation limits [u]."""
    scale: NDArray[np.float64]
    """Change of each knob that counts as one [u]; its range, say."""
    largest_change: NDArray[np.float64]
    """Largest change of what is given out, per sample [u]."""
    theta_lower: NDArray[np.float64]
    theta_upper: NDArray[np.float64]
    """The limits again [theta]."""
    normals: NDArray[np.float64] = np.empty((0, 1))
    """Shape (m, n): of each line between knobs a . u <= b: a times ``scale``, of length 1."""
    bounds: NDArray[np.float64] = np.empty(0)
    """Shape (m,): b of the same."""


class DirectionState(NamedTuple):
    """State between samples; :func:`answer` changes its arrays in place."""

    relay: RelayState
    """The relay along the direction; its u is s."""
    active: int
    legs: int
    """Direction that is sought along, and legs that have ended along it."""
    base: NDArray[np.float64]
    begin: NDArray[np.float64]
    output: NDArray[np.float64]
    """Shape (n,): where the direction begins, where the round began, and what was given out last
    [u]."""
    directions: NDArray[np.float64]
    """Shape (n, n): unit vectors, one a row."""
    own: NDArray[np.float64]
    """Shape (n, OWN): what each direction has of its own: its swing and the sense that comes
    next."""
    theta: NDArray[np.float64]
    """Shape (n,): control input that was given out last [theta]."""


def start(
    u: NDArray[np.float64],
    epsilon: NDArray[np.int64],
    output: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> DirectionState:
    """Return the state before the first sample: along each knob in turn, from ``u``.

    ``epsilon``, shape (n,), is the sign that each knob begins with; ``output`` and ``theta`` are
    what is there now [u and theta].
    """
    n = u.size
    own = np.zeros((n, OWN))
    own[:, FACTOR], own[:, EPSILON] = 1.0, epsilon
    base = np.zeros(1) if n == 1 else u.copy()  # one knob: s is u itself
    first = initial(u[0] if n == 1 else 0.0, int(epsilon[0]), u[0] if n == 1 else 0.0)
    return DirectionState(first, 0, 0, base, u.copy(), output.copy(), np.eye(n), own, theta.copy())


def memory(state: DirectionState) -> tuple[float, ...]:
    """Return what a controller goes on from after its end: what the relay does, and where."""
    where = (getattr(state, name).ravel().tolist() for name in LASTING)
    return (*relay.memory(state.relay), float(state.active), float(state.legs), *chain(*where))


def recalled(begin: DirectionState, numbers: Sequence[float], logarithmic: bool) -> DirectionState:
    """Return the state ``begin`` with what :func:`memory` has kept; it waits to join a run.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If those are not such numbers.
    """
    ends = np.cumsum([MEMORY, 2, *(getattr(begin, name).size for name in LASTING)])
    if len(numbers) != ends[-1] or numbers[1] not in (1.0, -1.0):
        raise ConfigError(f"begin: is not what a controller goes on from, {ends[-1]} numbers")
    of_relay, (active, legs), *where = np.split(np.array(numbers), ends[:-1])
    arrays = {
        name: values.reshape(getattr(begin, name).shape)
        for name, values in zip(LASTING, where, strict=True)
    }
    theta = np.array([exp(u) for u in arrays["output"]]) if logarithmic else arrays["output"].copy()
    return begin._replace(
        relay=relay.recalled(begin.relay, of_relay.tolist()),
        active=int(active) % theta.size, legs=int(legs), theta=theta, **arrays,
    )  # fmt: skip


def reset(k: Knobs, state: DirectionState, begin: DirectionState) -> DirectionState:
    """Return to the state ``begin``; what is given out gets there at its limited rate."""
    begin.output[:], begin.theta[:] = state.output, state.theta
    since_flip = min(state.relay.since_flip, -travel(k, begin))
    return begin._replace(relay=begin.relay._replace(since_flip=since_flip))


@njit()
def along(p: RelayParams, k: Knobs, state: DirectionState) -> RelayParams:
    """Return the relay's parameters with the limits that s has along the direction."""
    low, high = -math.inf, math.inf
    for i in range(state.base.size):
        d = state.directions[state.active, i] * k.scale[i]
        if d != 0.0:
            a, b = (k.lower[i] - state.base[i]) / d, (k.upper[i] - state.base[i]) / d
            low, high = max(low, min(a, b)), min(high, max(a, b))
    if state.base.size > 1:  # the base itself lies inside, whatever rounding says
        low, high = min(low, 0.0), max(high, 0.0)
    return replace(
        p, u_min=low, u_max=high, u_low=low, u_high=high, largest_change=math.inf,
        logarithmic=False, theta_min=low, theta_max=high, theta_low=low, theta_high=high,
    )  # fmt: skip


@njit()
def bring_inside(k: Knobs, u: NDArray[np.float64]) -> bool:
    """Project u onto limits and lines in turn until it keeps them; return False if it does not.

    To one line that is the shortest way (Bregman 1965, in units of ``scale``).
    """
    for _ in range(SWEEPS):
        inside = True
        for i in range(u.size):
            u[i] = min(max(u[i], k.lower[i]), k.upper[i])
        for j in range(k.bounds.size):
            beyond, size = -k.bounds[j], abs(k.bounds[j])
            for i in range(u.size):
                term = k.normals[j, i] * u[i] / k.scale[i]
                beyond, size = beyond + term, size + abs(term)
            if beyond > ROUNDED * size:
                inside = False
                for i in range(u.size):
                    u[i] -= beyond * k.normals[j, i] * k.scale[i]
        if inside:
            return True
    return False


@njit()
def rotate(p: RelayParams, k: Knobs, state: DirectionState) -> None:
    """End a round: the way of base becomes a direction, the others are made orthogonal to it."""
    directions, n = state.directions, state.base.size
    way = np.empty(n)
    for i in range(n):
        way[i] = (state.base[i] - state.begin[i]) / k.scale[i]
        state.begin[i] = state.base[i]
    if normalise(way) <= DIRECTIONS.progress * p.step_size * p.dwell_samples:
        return
    alike = 0
    for j in range(n):
        state.own[j, FACTOR], state.own[j, SHORT] = 1.0, 0.0
        if abs(product(directions[j], way)) > abs(product(directions[alike], way)):
            alike = j
    for i in range(n):  # assigning arrays takes seconds to compile
        directions[alike, i] = way[i]
    for j in range(n):
        if j == alike:
            continue
        for other in range(n):
            if other == alike or other < j:
                share = product(directions[j], directions[other])
                for i in range(n):
                    directions[j, i] -= share * directions[other, i]
        normalise(directions[j])


@njit()
def product(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the scalar product; a loop, as NumPy's takes a second to compile."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit()
def normalise(a: NDArray[np.float64]) -> float:
    """Make a vector one of length 1, where it has any; return the length that it had."""
    length = math.sqrt(product(a, a))
    if length > 0.0:
        for i in range(a.size):
            a[i] /= length
    return length


@njit()
def travel(k: Knobs, state: DirectionState) -> int:
    """Return the samples in which what is given out gets to base at its limited rate."""
    samples = 0
    for i in range(state.base.size):
        if state.output[i] != state.base[i]:
            ratio = abs(state.output[i] - state.base[i]) / k.largest_change[i]
            samples = max(samples, math.ceil(ratio - 1e-9))
    return samples


@njit()
def falls(swing: Swing) -> bool:
    """Return whether the leg's level is nearer to its least than where it began; one of none is."""
    fallen = swing.begin - swing.lowest
    return swing.lowest == math.inf or swing.level - swing.lowest <= 0.5 * fallen


@njit()
def switch(
    p: RelayParams, k: Knobs, state: DirectionState, line: RelayParams, turned: float, at_end: bool
) -> DirectionState:
    """Leave the direction for the next one; the relay stays where the cost fell up to a limit.

    ``line`` has the limits of s, ``turned`` is s where the leg that has ended began. A leg that
    has only not turned yet reaches a limit, too: the cost must have fallen until there.
    """
    relay_state, own = state.relay, state.own
    swing, s = relay_state.swing, relay_state.u
    rest = swing.centre if swing.centred >= SWING.centred else 0.5 * (turned + s)
    rest = s if at_end else rest
    rest = min(max(rest, line.u_min), line.u_max)
    for i in range(state.base.size):
        state.base[i] += rest * state.directions[state.active, i] * k.scale[i]
    bring_inside(k, state.base)
    ended = own[state.active]
    ended[FACTOR], ended[DIP], ended[SHORT] = swing.factor, swing.dip, swing.short
    ended[CENTRED], ended[EPSILON] = swing.centred, relay_state.epsilon
    if at_end:
        ended[EPSILON] = -relay_state.epsilon
    active = (state.active + 1) % state.base.size
    if active == 0:
        rotate(p, k, state)
    new = own[active]
    swing = Swing(
        new[FACTOR], 1.0, 0.0, 0.0, math.inf, swing.lowest_before, swing.reference, swing.noise,
        new[DIP], swing.legs, int(new[SHORT]), 0.0, 0.0, int(new[CENTRED]), 0.0, 0.0,
        0.0, 0.0, swing.calm,
    )  # fmt: skip
    relay_state = RelayState(
        0.0, int(new[EPSILON]), 0.0, 0.0, -travel(k, state), False, 0.0, 0.0, swing
    )
    return replace(state, relay=relay_state, active=active, legs=0)


@njit()
def answer(
    p: RelayParams,
    k: Knobs,
    state: DirectionState,
    arrival: int,
    switched: bool,
    settling: bool,
    r: float,
    hold_asked: bool,
) -> tuple[DirectionState, bool, bool]:
    """Answer one cost as :func:`relay_esc.relay.answer` does, with n knobs.

    Parameters
    ----------
    p : RelayParams
        Parameters; with several knobs ``step_size`` is in units of their scale, and the limits are
        those of ``k``.
    k : Knobs
        The knobs' limits.
    state : DirectionState
        State after the previous cost; its arrays are changed.
    arrival, switched, settling, r, hold_asked
        See there.

    Returns
    -------
    state : DirectionState
        State after this cost; ``theta`` is the control input to apply.
    holding, saturated : bool
        See there; not holding while theta moves to where a direction begins; saturated: a knob is
        at one of its limits.
    """
    before = state.relay
    line = p if state.base.size == 1 else along(p, k, state)
    after, holding, saturated = relay.answer(
        line, before, arrival, switched, settling, r, hold_asked
    )
    legs = state.legs + (after.epsilon != before.epsilon)
    state = replace(state, relay=after, legs=legs)
    if state.base.size == 1:
        state.output[0], state.theta[0] = after.commanded, after.output
        return state, holding, saturated
    down, dwelt = after.epsilon > 0, after.since_flip >= p.dwell_samples
    at_end = dwelt and after.u == (line.u_min if down else line.u_max) and falls(after.swing)
    if legs == DIRECTIONS.legs or at_end:
        state = switch(p, k, state, line, before.swing.turned, at_end)
    moved = before.since_flip == -1  # it has got to where the direction begins
    wanted, saturated, share = np.empty(state.base.size), False, 1.0
    for i in range(wanted.size):
        wanted[i] = state.base[i] + state.relay.u * state.directions[state.active, i] * k.scale[i]
    if not bring_inside(k, wanted):
        share = 0.0
    for i in range(wanted.size):
        change = abs(wanted[i] - state.output[i])
        if k.bounds.size > 0 and change > k.largest_change[i]:
            share = min(share, k.largest_change[i] / change)
    for i in range(wanted.size):
        u, before = wanted[i], state.output[i]
        aim = u if share == 1.0 else before + share * (u - before)
        state.output[i] = slew(before, aim, k.largest_change[i])
        moved = moved or state.output[i] != before
        saturated = saturated or u <= k.lower[i] or u >= k.upper[i]
        theta = exp(state.output[i]) if p.logarithmic else state.output[i]
        if k.lower[i] <= state.output[i] <= k.upper[i]:  # not beyond a limit by rounding
            theta = min(max(theta, k.theta_lower[i]), k.theta_upper[i])
        state.theta[i] = theta
    return state, holding and not moved, saturated
