"""A surrogate: a model of the rig from its excitation, compiled, with the loop closed.

The cost's level l and the amplitude's logarithm a follow their static maps, of which tau(theta, up
or down) is fitted to the recording:

    dl/dt = (L(theta) - l) / tau,   da/dt = (A(theta) - a) / tau,
    log tau = c_0 + c_1 (A(theta) - mean A) + c_2 sign(A(theta) - a)

y_out is what was recorded at the nearest value of theta once the rig had settled, times
exp(l - L_recorded): ripple, noise, interference and how they go on are the rig's own. A segment is
played from a random place on; at its end, or when another value is nearer, the next one begins
where y_out is about the same.

A coarse surrogate is for trying much in little time: it plays the root mean square of y_hp, which
is what the high-pass filter leaves of y_out, over blocks of samples. What the low-pass filter and
the relay make of it is the nodes' own kernels', at the time step of the blocks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_identify.recording.loaded import Loaded, list_segments
from koop_tune.excitation.static_map import GRID, StaticMap
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import Dwells
from koop_tune.rig_model.fluctuation import FLUCTUATION, fit_fluctuation
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState
from relay_esc import barrier, directions
from relay_esc.barrier import BarrierParams
from relay_esc.directions import DirectionState, Knobs
from relay_esc.relay import RelayParams, RelayState

PLACES = 16  # that are looked at for one where y_out is about the same
BLOCKS = 200  # that a run is told in


class Times(NamedTuple):
    """How the amplitude follows theta: c_0, c_1, c_2 [log s], and the mean of A."""

    usual: float
    slope: float
    up: float
    middle: float

    def tau(self, a: float, rises: bool) -> float:
        """Return the time constant [s] towards a level."""
        return math.exp(
            self.usual + self.slope * (a - self.middle) + (1 if rises else -1) * self.up
        )


class Playing(NamedTuple):
    """A surrogate at a time: l and a, and where its y_out is played from."""

    level: float
    amplitude: float
    value: int
    number: int
    segment: int
    place: int


class KnobsBowl(NamedTuple):
    """How far n knobs are from their best: |B (v - v*)| of the positions v of all knobs.

    Attributes
    ----------
    low, high, logarithmic : ndarray, shape (n,)
        Range of each knob, and whether positions are on a scale of its logarithm.
    best : ndarray, shape (n,)
        v*.
    root : ndarray, shape (n, n)
        B.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    logarithmic: NDArray[np.bool_]
    best: NDArray[np.float64]
    root: NDArray[np.float64]

    def distance(self, v: NDArray[np.float64]) -> float:
        """Return it at positions, shape (n,)."""
        return float(np.linalg.norm(self.root @ (v - self.best)))


class Surrogate(NamedTuple):
    """A model of the rig that is compatible with the recording.

    Attributes
    ----------
    levels, amplitudes : ndarray, shape (GRID,)
        L and A at positions of theta from 0 to 1.
    u : ndarray, shape (N,)
        Positions that were recorded.
    recorded : ndarray, shape (N,)
        L of the recording there.
    y : ndarray, shape (S,)
        What was recorded of y_out, segment after segment, without its mean.
    begins : ndarray, shape (P + 1,)
        First sample of each segment.
    first : ndarray, shape (N + 1,)
        First segment of each value of theta.
    times : Times
        Time constants.
    dt : float
        Sampling time [s].
    low, high : float
        Range of theta.
    logarithmic : bool
        Whether positions are on a scale of log theta.
    coarse : bool
        Whether ``y`` is the root mean square of y_hp over dt.
    """

    levels: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    u: NDArray[np.float64]
    recorded: NDArray[np.float64]
    y: NDArray[np.float64]
    begins: NDArray[np.int64]
    first: NDArray[np.int64]
    times: Times
    dt: float
    low: float
    high: float
    logarithmic: bool
    coarse: bool


def high_pass(
    y_out: NDArray[np.float64], loaded: Loaded, omega_h: float, dt: float
) -> NDArray[np.float64]:
    """Return y_hp of the detector for every sample of a recording."""
    from scipy.signal import lfilter  # slow to import

    alpha = math.exp(-omega_h * dt)
    filtered = np.zeros(y_out.size)
    for segment in list_segments(loaded.begins):
        part = y_out[segment]
        usable = np.flatnonzero(np.isfinite(part))
        if usable.size > 1:
            part = np.where(np.isfinite(part), part, part[usable[0]])
            filtered[segment] = lfilter([1.0 - alpha, alpha - 1.0], [1.0, -alpha], part - part[0])
    return filtered


def fit_times(
    loaded: Loaded, dwells: Dwells, static_map: StaticMap, scale: Scale, dt: float
) -> Times:
    """Fit the time constants to the amplitude's logarithm in the windows of all rests.

    Where noise drives the oscillation its amplitude is seldom where theta leads it: how it comes
    and goes by itself tells the time constant far better than how it follows theta does.
    """
    from scipy.optimize import minimize  # slow to import

    assert loaded.theta is not None
    every = max(1, dwells.length // 4)
    curve = static_map.curve
    age = dwells.middles.max() - np.arange(loaded.theta.size)
    age /= max(float(np.ptp(dwells.middles)), 1.0)
    position = np.nan_to_num(scale.u(loaded.theta), nan=0.5) + static_map.motion * age
    target = np.interp(position[::every], np.linspace(0.0, 1.0, GRID), curve)
    jumps = loaded.begins[: target.size * every]
    begins = np.zeros(target.size, np.bool_)
    begins[np.flatnonzero(jumps) // every] = True
    starts = (
        np.concatenate([np.arange(s.begin, s.end, dwells.length) for s in dwells.rests]) // every
    )
    measured = np.concatenate(dwells.logs)
    middle = float(np.mean(curve))
    usual = 0.02 + float(np.median([v.std() for v in dwells.settled(dwells.logs)]))
    process = fit_fluctuation(dwells)
    if process.share > FLUCTUATION.wanders:
        return Times(math.log(process.time), 0.0, 0.0, middle)
    longest = max(s.end - s.begin for s in dwells.rests) * dt
    shortest = 0.05 * dwells.length * dt
    path = np.empty(target.size)

    def loss(c: NDArray[np.float64]) -> float:
        _follow(target, begins, every * dt, Times(c[0], c[1], c[2], middle), path)
        levels = sum(path[np.minimum(starts + j, path.size - 1)] for j in range(4)) / 4.0
        error = np.minimum(np.abs(levels - measured) / usual, 5.0)
        beyond = max(0.0, c[0] - math.log(longest)) + max(0.0, math.log(shortest) - c[0])
        prior = 0.5 * c[1] ** 2 + 5.0 * c[2] ** 2 + 100.0 * beyond**2
        return float((error**2).sum()) + prior

    tries = [np.array([x, 0.0, 0.0]) for x in np.linspace(math.log(shortest), math.log(longest), 9)]
    begin = min(tries, key=loss)
    best = minimize(loss, begin, method="Nelder-Mead", options={"maxfev": 250, "xatol": 0.02})
    c = best.x
    return Times(float(c[0]), float(np.clip(c[1], -2, 2)), float(np.clip(c[2], -1, 1)), middle)


@njit()
def _rate(times: Times, dt: float, target: float, now: float) -> float:
    side = times.up if target > now else -times.up
    return 1.0 - math.exp(
        -dt / math.exp(times.usual + times.slope * (target - times.middle) + side)
    )


@njit()
def _follow(
    target: NDArray[np.float64], begins: NDArray[np.bool_], dt: float, times: Times,
    path: NDArray[np.float64],
) -> None:  # fmt: skip
    level = target[0]
    for k in range(target.size):
        if begins[k]:
            level = target[k]
        level += (target[k] - level) * _rate(times, dt, target[k], level)
        path[k] = level


@njit()
def _at(values: NDArray[np.float64], u: float) -> float:
    place = min(max(u, 0.0), 1.0) * (values.size - 1)
    i = min(int(place), values.size - 2)
    return values[i] + (place - i) * (values[i + 1] - values[i])


@njit()
def _position(low: float, high: float, logarithmic: bool, theta: float) -> float:
    if logarithmic:
        return math.log(theta / low) / math.log(high / low)
    return (theta - low) / (high - low)


@njit()
def _nearest(u: NDArray[np.float64], x: float) -> int:
    best = 0
    for i in range(1, u.size):
        if abs(u[i] - x) < abs(u[best] - x):
            best = i
    return best


@njit()
def _next_place(
    s: Surrogate, level: int, value: float, draws: NDArray[np.float64], number: int
) -> tuple[int, int]:
    """Return segment and sample of a value of theta where y_out is about ``value``."""
    segment = place = -1
    best = math.inf
    for i in range(PLACES):
        candidate = s.first[level] + int(draws[(number + 2 * i) % draws.size]
                                   * (s.first[level + 1] - s.first[level]))  # fmt: skip
        size = s.begins[candidate + 1] - s.begins[candidate]
        at = s.begins[candidate] + int(draws[(number + 2 * i + 1) % draws.size] * 0.9 * size)
        far = abs(s.y[at] - value)
        if far < best:
            best, segment, place = far, candidate, at
    return segment, place


@njit(inline="always")
def _settle(
    s: Surrogate, start: float, position: float, draws: NDArray[np.float64]
) -> Playing:  # fmt: skip
    """Return a rig that has settled at ``start``, with theta at a position."""
    value = _nearest(s.u, position)
    segment, place = _next_place(s, value, 0.0, draws, 0)
    return Playing(_at(s.levels, start), _at(s.amplitudes, start), value, 0, segment, place)


@njit(inline="always")
def _play(s: Surrogate, p: Playing) -> float:
    """Return y_out."""
    return math.exp(p.level - s.recorded[p.value]) * s.y[p.place]


@njit(inline="always")
def _advance(
    s: Surrogate, p: Playing, y: float, moved: float, draws: NDArray[np.float64]
) -> Playing:  # fmt: skip
    """Return the rig after a sample of y_out at a position."""
    aim, target = _at(s.levels, moved), _at(s.amplitudes, moved)
    rate = _rate(s.times, s.dt, target, p.amplitude)
    level = p.level + (aim - p.level) * rate
    amplitude = p.amplitude + (target - p.amplitude) * rate
    value, number, segment, place = p.value, p.number, p.segment, p.place + 1
    near = value
    if abs(s.u[value] - moved) > 0.01:
        near = _nearest(s.u, min(max(moved, 0.0), 1.0))
        if abs(s.u[near] - moved) > abs(s.u[value] - moved) - 0.01:
            near = value
    if near != value or place >= s.begins[segment + 1]:
        number += 2 * PLACES
        wanted = y * math.exp(s.recorded[near] - level)
        segment, place = _next_place(s, near, wanted, draws, number)
        value = near
    return Playing(level, amplitude, value, number, segment, place)


@njit(inline="always")
def _hear(
    s: Surrogate, detector: DetectorParams, state: DetectorState, arrival: int, y: float
) -> tuple[float, DetectorState]:
    """Return the cost of y_out."""
    # a filter without memory makes of this sum what is added
    return cost.follow(detector, state, arrival, state.y_previous + y if s.coarse else y)


@njit(nogil=True)
def run(
    s: Surrogate,
    detector: DetectorParams,
    params: RelayParams,
    state: RelayState,
    steps: int,
    drift: float,
    start: float,
    draws: NDArray[np.float64],
    u: NDArray[np.float64],
    power: NDArray[np.float64],
    bound: BarrierParams,
    edge: float,
) -> None:
    """Close the loop for some steps, from a rig that has settled.

    Parameters
    ----------
    s : Surrogate
        The rig.
    detector, params, state
        The controller, which joins the run.
    steps : int
        Samples of the run.
    drift : float
        Motion of the optimum in one sample [u].
    start : float
        Position of theta at which the rig has settled before; the controller's own limits may be
        narrower.
    draws : ndarray
        Random numbers of [0, 1).
    u, power : ndarray, shape (BLOCKS,)
        Receive the mean of theta's position from the optimum's motion, and the mean square of the
        amplitude, of each block.
    bound, edge : BarrierParams, float
        Barrier of a constraint, and where its margin is 0 [the controller's u].
    """
    s, draws = borrowed((s, draws))
    margins = barrier.UNKNOWN
    cost_state = cost.initial()
    position = _position(s.low, s.high, s.logarithmic, state.output)
    playing = _settle(s, start, position, draws)
    u[:] = 0.0
    power[:] = 0.0
    block = steps / u.size
    for k in range(steps):
        arrival = Arrival.JOIN if k == 0 else Arrival.NEXT
        y = _play(s, playing)
        r, cost_state = _hear(s, detector, cost_state, arrival, y)
        state, margins, _, _ = barrier.answer(
            params, bound, state, margins, arrival, False, cost_state.settling > 0, r, False,
            bound.slope * (state.commanded - edge),
        )  # fmt: skip
        moved = _position(s.low, s.high, s.logarithmic, state.output) - drift * k
        playing = _advance(s, playing, y, moved, draws)
        i = min(int(k / block), u.size - 1)
        u[i] += moved
        power[i] += math.exp(2.0 * playing.amplitude)
    u /= block
    power /= block


@njit(nogil=True)
def run_knobs(
    s: Surrogate,
    bowl: KnobsBowl,
    detector: DetectorParams,
    params: RelayParams,
    limits: Knobs,
    state: DirectionState,
    steps: int,
    drift: NDArray[np.float64],
    start: float,
    draws: NDArray[np.float64],
    away: NDArray[np.float64],
    power: NDArray[np.float64],
) -> None:
    """Close the loop of several knobs as :func:`run` does.

    ``s`` is a rig over how far all knobs are from the best, ``bowl`` says how far; ``drift`` has
    the shape (n,), and ``away``, shape (n, BLOCKS), receives how far each knob is.
    """
    s, draws, bowl, limits, state = borrowed((s, draws, bowl, limits, state))
    cost_state = cost.initial()
    n = drift.size
    off = np.empty(n)
    playing = _settle(s, start, start, draws)
    away[:] = 0.0
    power[:] = 0.0
    block = steps / power.size
    for k in range(steps):
        arrival = Arrival.JOIN if k == 0 else Arrival.NEXT
        y = _play(s, playing)
        r, cost_state = _hear(s, detector, cost_state, arrival, y)
        state, _, _ = directions.answer(
            params, limits, state, arrival, False, cost_state.settling > 0, r, False
        )
        i = min(int(k / block), power.size - 1)
        for j in range(n):
            position = _position(bowl.low[j], bowl.high[j], bowl.logarithmic[j], state.theta[j])
            off[j] = position - bowl.best[j] - drift[j] * k
            away[j, i] += abs(off[j])
        square = 0.0
        for j in range(n):
            square += directions.product(bowl.root[j], off) ** 2
        playing = _advance(s, playing, y, math.sqrt(square), draws)
        power[i] += math.exp(2.0 * playing.amplitude)
    away /= block
    power /= block
