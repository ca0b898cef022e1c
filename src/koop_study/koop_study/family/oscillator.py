"""One step of a rig of the family, and its measurement; compiled.

The oscillation is a complex amplitude z = a exp(i phi) that turns by 2 pi f dt a step. theta sets
the level L(theta) that a settles at, with the time constant tau(theta); both kinds are exact for
a theta that rests over the step, so no step size is too large:

    limit cycle    d a^2/dt = a^2 (1 - a^2 / L^2) / tau,   phi with a random walk (Stuart, Landau)
    noise-driven   dz = -z dt / tau + L sqrt(2 / tau) dw,   complex white noise of unit intensity

In both the root mean square of |z| at a resting theta is L(theta) itself: the truth needs no
simulation. With u in [0, 1] the position of theta in its range (on a log scale where the rig has
one), u* the optimum's position and e the distance from u* beyond a flat bottom,

    L = L* sqrt(1 + (e / w)^2p)   to be minimised,      L = L* / sqrt(1 + (e / w)^2p)   maximised,

with a width w for each side; as the paper's plant, a^2 = 1 + (theta - theta*)^2, is for p = 1.
A rig without an optimum has L exponential in u, or constant. Further maps:

    narrow         with x = (e / w)^2p, 1 + x becomes (1 + x) / (1 + x / D^2): L ends at D L*, and
                   the skirts are a tuned absorber's (for p = 1 the gain of a notch filter)
    two valleys    the lesser of L and s L* sqrt(1 + (|u - u* - d| / w')^2p), s > 1
    two modes      a second oscillation at another frequency: L_1 falls and L_2 rises exponentially
                   with u; L^2 = L_1^2 + L_2^2 is least at u*, see :func:`two_modes`

Between theta and what acts on the rig there may be a play b: u follows theta's position only where
that is further than b / 2 away (backlash).

A channel is  m_1 Re z + m_2 Im z + m_3 Re z^2 / L_mid + offset + interference + white noise, and
m_4 Re z' + m_5 Im z' of a second oscillation z'.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_study.family.settings import FAMILY

LIMIT_CYCLE = 0
NOISE_DRIVEN = 1
BOWL = 0
MONOTONE = 1
FLAT = 2
TWO_VALLEYS = 3
TWO_MODES = 4


class RigParams(NamedTuple):
    """Constants of a rig."""

    kind: int
    """LIMIT_CYCLE or NOISE_DRIVEN."""
    turn: float
    jitter: float
    """Phase of a step [rad], and the standard deviation of its random part."""
    dt: float
    """Sampling time [s]."""
    theta_min: float
    theta_max: float
    """Range of theta; the rig clips to it."""
    log_scale: bool
    """Whether u is the position of log theta."""
    shape: int
    """BOWL, MONOTONE, FLAT, TWO_VALLEYS or TWO_MODES."""
    sense: float
    """+1 if L* is the smallest level, -1 if it is the largest."""
    best: float
    level: float
    """u* at t = 0 and L*; of a monotone map, L at u = 1/2."""
    width_below: float
    width_above: float
    flat: float
    power: float
    """w on the two sides of u*, half the width of the bottom, p; a monotone map has the slope of
    log L in ``width_above``, two modes the slopes of -log L_1 and log L_2 in both."""
    saturation: float
    """D, largest gain of a narrow map; infinite of others."""
    apart: float
    other_width: float
    shallower: float
    """d, w' and s of a second valley."""
    play: float
    """b, backlash of theta, in u."""
    drift: float
    """Motion of u* [1/s], turning at the margin."""
    tau: float
    exponent: float
    tau_low: float
    tau_high: float
    """tau(theta) = tau (L / L*)^exponent within its limits [s]."""
    middle: float
    """L_mid, geometric mean of the smallest and the largest level at t = 0."""
    second: float
    """Frequency of the second oscillation over the first's."""
    mix: NDArray[np.float64]
    """Shape (n, 5): m_1 to m_5 of each of n channels."""
    offset: NDArray[np.float64]
    noise: NDArray[np.float64]
    """Shape (n,): offset and standard deviation of the white noise of each channel."""
    tone: NDArray[np.float64]
    """Shape (m,): frequencies of the interference [rad/s]."""
    tone_amplitude: NDArray[np.float64]
    tone_phase: NDArray[np.float64]
    """Shape (m, n): what reaches each channel of it."""


class RigState(NamedTuple):
    """z = re + i im, z' = other_re + i other_im, and the position of the theta that acts."""

    re: float
    im: float
    other_re: float
    other_im: float
    u: float


@njit()
def position(p: RigParams, theta: float) -> float:
    """Return u, the position of theta in its range, 0 to 1."""
    theta = min(max(theta, p.theta_min), p.theta_max)
    if p.log_scale:
        return math.log(theta / p.theta_min) / math.log(p.theta_max / p.theta_min)
    return (theta - p.theta_min) / (p.theta_max - p.theta_min)


@njit()
def theta_at(p: RigParams, u: float) -> float:
    """Return theta at a position; the inverse of :func:`position`."""
    u = min(max(u, 0.0), 1.0)
    if p.log_scale:
        theta = p.theta_min * math.exp(u * math.log(p.theta_max / p.theta_min))
    else:
        theta = p.theta_min + u * (p.theta_max - p.theta_min)
    return min(max(theta, p.theta_min), p.theta_max)


@njit()
def best_position(p: RigParams, t: float) -> float:
    """Return u* at a time [s]."""
    if p.drift == 0.0:
        return p.best
    inside = 1.0 - 2.0 * FAMILY.margin
    way = (p.best - FAMILY.margin + p.drift * t) % (2.0 * inside)
    return FAMILY.margin + (way if way <= inside else 2.0 * inside - way)


@njit()
def two_modes(p: RigParams, u: float, t: float) -> tuple[float, float]:
    """Return L_1 and L_2 of a rig with two modes.

    With slopes a, b and c = alive they are, with e = u - u*,

        (L_1 / L*)^2 = c^2 + (1 - 2 c^2) b / (a + b) exp(-2 a e)
        (L_2 / L*)^2 = c^2 + (1 - 2 c^2) a / (a + b) exp(2 b e)

    so that the derivative of their sum is 0 at u*, and the sum 1.
    """
    a, b, e = p.width_below, p.width_above, u - best_position(p, t)
    floor = FAMILY.alive * FAMILY.alive
    share = (1.0 - 2.0 * floor) / (a + b)
    return (
        p.level * math.sqrt(floor + share * b * math.exp(-2.0 * a * e)),
        p.level * math.sqrt(floor + share * a * math.exp(2.0 * b * e)),
    )


@njit()
def level(p: RigParams, u: float, t: float) -> float:
    """Return L, the amplitude (root mean square) that position u leads to at a time [s]."""
    if p.shape == FLAT:
        return p.level
    if p.shape == MONOTONE:
        return p.level * math.exp(p.width_above * (u - 0.5))
    if p.shape == TWO_MODES:
        first, second = two_modes(p, u, t)
        return math.sqrt(first * first + second * second)
    beyond = u - best_position(p, t)
    width = p.width_above if beyond > 0.0 else p.width_below
    rise = (max(abs(beyond) - p.flat, 0.0) / width) ** (2.0 * p.power)
    gain = math.sqrt((1.0 + rise) / (1.0 + rise / p.saturation**2))
    if p.shape == TWO_VALLEYS:
        rise = (abs(beyond - p.apart) / p.other_width) ** (2.0 * p.power)
        gain = min(gain, p.shallower * math.sqrt(1.0 + rise))
    return p.level * gain if p.sense > 0.0 else p.level / gain


@njit()
def levels(p: RigParams, u: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Return :func:`level` of positions, shape (M,)."""
    result = np.empty(u.shape[0])
    for i in range(u.shape[0]):
        result[i] = level(p, u[i], t)
    return result


@njit()
def relaxation(p: RigParams, settled: float) -> float:
    """Return tau [s] at the level ``settled``."""
    return min(max(p.tau * (settled / p.level) ** p.exponent, p.tau_low), p.tau_high)


@njit()
def acting(p: RigParams, state: RigState, theta: float) -> float:
    """Return the position of the theta that acts under a commanded one."""
    u = position(p, theta)
    return min(max(state.u, u - 0.5 * p.play), u + 0.5 * p.play)


@njit()
def energy(state: RigState) -> float:
    r"""Return the square of the amplitude, \|z\|^2 + \|z'\|^2."""
    first = state.re * state.re + state.im * state.im
    return first + state.other_re * state.other_re + state.other_im * state.other_im


@njit()
def _advance(
    p: RigParams, settled: float, fade: float, turn: float, re: float, im: float,
    noise_1: float, noise_2: float,
) -> tuple[float, float]:  # fmt: skip
    """Advance one oscillation that settles at a level and turns by an angle."""
    if p.kind == NOISE_DRIVEN:
        c, s = fade * math.cos(turn), fade * math.sin(turn)
        kick = settled * math.sqrt(0.5 * (1.0 - fade * fade))
        return c * re - s * im + kick * noise_1, s * re + c * im + kick * noise_2
    square = max(re * re + im * im, 1e-12 * settled * settled)
    after = settled * settled / (1.0 + (settled * settled / square - 1.0) * fade)
    gain = math.sqrt(after / square)
    angle = turn + p.jitter * noise_1
    c, s = gain * math.cos(angle), gain * math.sin(angle)
    return c * re - s * im, s * re + c * im


@njit()
def step(
    p: RigParams, state: RigState, k: int, theta: float, noise_1: float, noise_2: float
) -> RigState:
    """Advance by one step: z(t_k) to z(t_{k+1}), theta held.

    Parameters
    ----------
    p : RigParams
        The rig.
    state : RigState
        At t_k = k dt.
    k : int
        Step index; it decides where a moving optimum is.
    theta : float
        Control input, clipped to the rig's range.
    noise_1, noise_2 : float
        Two standard normal numbers; swapped they drive the second oscillation, which leaves the two
        uncorrelated.
    """
    u = acting(p, state, theta)
    settled = level(p, u, k * p.dt)
    fade = math.exp(-p.dt / relaxation(p, settled))
    if p.shape != TWO_MODES:
        re, im = _advance(p, settled, fade, p.turn, state.re, state.im, noise_1, noise_2)
        return RigState(re, im, 0.0, 0.0, u)
    first, second = two_modes(p, u, k * p.dt)
    re, im = _advance(p, first, fade, p.turn, state.re, state.im, noise_1, noise_2)
    other_re, other_im = _advance(
        p, second, fade, p.second * p.turn, state.other_re, state.other_im, noise_2, noise_1
    )
    return RigState(re, im, other_re, other_im, u)


@njit()
def measure(
    p: RigParams,
    state: RigState,
    k: int,
    noise: NDArray[np.float64],
    x: NDArray[np.float64],
) -> None:
    """Fill ``x``, shape (n,), with the measurement at t_k.

    ``noise``, shape (n,), are standard normal numbers.
    """
    t = k * p.dt
    harmonic = (state.re * state.re - state.im * state.im) / p.middle
    for i in range(x.shape[0]):
        value = p.mix[i, 0] * state.re + p.mix[i, 1] * state.im + p.mix[i, 2] * harmonic
        value += p.mix[i, 3] * state.other_re + p.mix[i, 4] * state.other_im
        for j in range(p.tone.shape[0]):
            value += p.tone_amplitude[j, i] * math.sin(p.tone[j] * t + p.tone_phase[j, i])
        x[i] = value + p.offset[i] + p.noise[i] * noise[i]


@njit()
def run(
    p: RigParams,
    state: RigState,
    first: int,
    theta: NDArray[np.float64],
    noise: NDArray[np.float64],
    x: NDArray[np.float64],
    amplitude: NDArray[np.float64],
) -> RigState:
    """Run along a given theta from step ``first`` on.

    Parameters
    ----------
    theta : ndarray, shape (M,)
        Control input of each step.
    noise : ndarray, shape (M, 2 + n)
        Standard normal numbers: two of the rig, one a channel.
    x : ndarray, shape (M, n)
        Receives the channels.
    amplitude : ndarray, shape (M,)
        Receives the root of :func:`energy`.
    """
    for k in range(theta.shape[0]):
        measure(p, state, first + k, noise[k, 2:], x[k])
        amplitude[k] = math.sqrt(energy(state))
        state = step(p, state, first + k, theta[k], noise[k, 0], noise[k, 1])
    return state
