"""The cost r_k: instantaneous energy of the measured state, then an amplitude detector.

    raw:     y_out = ||x'||_2 / sqrt(n)         (n = 2 in the paper, section 3.4)
    lifted:  y_out = ||V_dom^+ g(x')||_2^2

    y_hp,k = a_hp y_hp,k-1 + (1 - a_hp) (y_out,k - y_out,k-1),   a_hp = exp(-omega_h dt)
    y_lp,k = a_lp y_lp,k-1 + (1 - a_lp) y_hp,k^2,                a_lp = exp(-omega_l dt)
    r_k    = max(y_lp,k, 0)                     (after Wang and Krstic 2000)

The detector starts from the first measurement, not from zero: the first difference is 0.

Functions that take arrays are inlined before compilation: each call would count references to them,
which costs as much as the arithmetic.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from koopman_lifter.observables import lift_into

RAW = 0
LIFTED = 1


class Lifting(NamedTuple):
    """Arrays that take a measured state to its dominant modal coordinates.

    Attributes
    ----------
    parent, factor : ndarray of int64, shape (p,)
        Recursion of the monomials, see :class:`koopman_lifter.observables.Monomials`.
    projector : ndarray, shape (N, p)
        W with ||W z||_2 = ||V_dom^+ z||_2, see :func:`koopman_lifter.modes.projector`.
    """

    parent: NDArray[np.int64]
    factor: NDArray[np.int64]
    projector: NDArray[np.float64]


class DetectorParams(NamedTuple):
    """Scalars of the amplitude detector.

    Attributes
    ----------
    alpha_hp, alpha_lp : float
        Filter coefficients exp(-omega dt) [-].
    y_max : float
        Largest y_out that is believed; finite.
    """

    alpha_hp: float
    alpha_lp: float
    y_max: float


class DetectorState(NamedTuple):
    """What the detector remembers; ``primed`` is False if the next sample follows on none."""

    y_previous: float
    y_hp: float
    y_lp: float
    primed: bool


def detector_params(
    omega_h: float, omega_l: float, dt: float, y_max: float = sys.float_info.max
) -> DetectorParams:
    """Return the scalars for corner frequencies [rad/s], a sampling time [s] and a limit."""
    return DetectorParams(math.exp(-omega_h * dt), math.exp(-omega_l * dt), y_max)


def initial() -> DetectorState:
    """Return the state before the first sample."""
    return DetectorState(0.0, 0.0, 0.0, False)


@njit(cache=True)
def resume(state: DetectorState) -> DetectorState:
    """Keep the filters over a silence, so that the next sample is no jump.

    Starting them from zero instead would let r climb again, which looks like a cost that gets
    worse and turns the relay for nothing.
    """
    return DetectorState(state.y_previous, state.y_hp, state.y_lp, False)


@njit(cache=True, inline="always")
def raw_energy(x: NDArray[np.float64]) -> float:
    """Return ||x||_2 / sqrt(n) of a state, shape (n,)."""
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * x[i]
    return math.sqrt(total / x.shape[0])


@njit(cache=True, inline="always")
def lifted_energy(lifting: Lifting, x: NDArray[np.float64], z: NDArray[np.float64]) -> float:
    """Return ||V_dom^+ g(x)||_2^2 of a state, shape (n,); ``z``, shape (p,), receives g(x)."""
    lift_into(lifting.parent, lifting.factor, x, z)
    total = 0.0
    for j in range(lifting.projector.shape[0]):
        c = 0.0
        for i in range(z.shape[0]):
            c += lifting.projector[j, i] * z[i]
        total += c * c
    return total


@njit(cache=True, inline="always")
def energy(source: int, lifting: Lifting, x: NDArray[np.float64], z: NDArray[np.float64]) -> float:
    """Return y_out of a state for ``source`` RAW or LIFTED."""
    if source == LIFTED:
        return lifted_energy(lifting, x, z)
    return raw_energy(x)


@njit(cache=True)
def detect(p: DetectorParams, state: DetectorState, y_out: float) -> tuple[float, DetectorState]:
    """Process one sample of the amplitude detector.

    Parameters
    ----------
    p : DetectorParams
        Filter coefficients.
    state : DetectorState
        State after the previous sample.
    y_out : float
        Instantaneous energy; must be finite.

    Returns
    -------
    r : float
        Cost, the low-pass filtered square of the high-pass filtered energy.
    state : DetectorState
        State after this sample.
    """
    if not state.primed:
        return max(state.y_lp, 0.0), DetectorState(y_out, state.y_hp, state.y_lp, True)
    y_hp = p.alpha_hp * state.y_hp + (1.0 - p.alpha_hp) * (y_out - state.y_previous)
    y_lp = p.alpha_lp * state.y_lp + (1.0 - p.alpha_lp) * (y_hp * y_hp)
    return max(y_lp, 0.0), DetectorState(y_out, y_hp, y_lp, True)


@njit(cache=True, inline="always")
def step(
    source: int,
    lifting: Lifting,
    p: DetectorParams,
    state: DetectorState,
    x: NDArray[np.float64],
    z: NDArray[np.float64],
) -> tuple[float, float, DetectorState]:
    """Process one measured state.

    Parameters
    ----------
    source : int
        RAW or LIFTED.
    lifting : Lifting
        Arrays of the model.
    p : DetectorParams
        Filter coefficients.
    state : DetectorState
        Detector after the previous sample.
    x : ndarray, shape (n,)
        Measured state x'_k.
    z : ndarray, shape (p,)
        Scratch; receives g(x'_k) for LIFTED.

    Returns
    -------
    r, y_out : float
        Cost and instantaneous energy; r is NaN where y_out is above y_max, or r not finite.
    state : DetectorState
        Detector after this sample; unchanged where r is NaN.
    """
    y_out = energy(source, lifting, x, z)
    if not y_out <= p.y_max:  # nor if it is NaN
        return math.nan, y_out, state
    r, after = detect(p, state, y_out)
    if not math.isfinite(r):  # an infinite low-pass filter would stay so for ever
        return math.nan, y_out, state
    return r, y_out, after
