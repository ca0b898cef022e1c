"""Classic sinusoidal-perturbation extremum seeking, a baseline (Krstic and Wang 2000).

    J_k       = log r_k  (or r_k)
    xi_k      = washout_k J,   corner omega_w
    g_k       = low-pass_k (xi_k sin(omega t_k)),   corner omega_g
    centre   <- centre - gain g_k dt
    theta_k   = clip(centre + a sin(omega t_k))

The logarithm takes the scale out of the cost, which the relay never sees: r falls by decades
between theta = 2 and the optimum, and one gain cannot serve both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from koop_core.config.parameter import parameter, validate
from koop_core.kernels import njit
from relay_esc.config import EscConfig

FLOOR = 1e-300  # keeps the logarithm of a cost of 0 finite; costs are far larger


class PerturbationParams(NamedTuple):
    """Scalars of the kernel, see :class:`PerturbationConfig`."""

    amplitude: float
    omega: float
    gain: float
    alpha_w: float
    alpha_g: float
    logarithm: bool
    dt: float
    theta_min: float
    theta_max: float


class PerturbationState(NamedTuple):
    """What the controller remembers: centre of the dither, theta, filters, sample count."""

    centre: float
    theta: float
    slow_cost: float
    gradient: float
    k: int


@dataclass(frozen=True)
class PerturbationConfig:
    """Dither, demodulation and gain of the classic scheme."""

    amplitude: float = parameter(0.3, "amplitude a of the dither", low=0.0, high=5.0)
    omega: float = parameter(0.1, "frequency of the dither", unit="rad/s", low=1e-4, high=100.0)
    gain: float = parameter(0.3, "adaptation gain", unit="1/s", low=0.0, high=1e6)
    omega_w: float = parameter(0.03, "corner of the washout", unit="rad/s", low=1e-5, high=100.0)
    omega_g: float = parameter(
        0.03, "corner of the gradient's low-pass filter", unit="rad/s", low=1e-5, high=100.0
    )
    logarithm: bool = parameter(True, "seek the minimum of log r in place of r")

    def __post_init__(self) -> None:
        validate(self)

    def params(self, esc: EscConfig) -> PerturbationParams:
        """Return the values that :func:`step` takes; limits and step from the relay's config."""
        return PerturbationParams(
            self.amplitude,
            self.omega,
            self.gain,
            math.exp(-self.omega_w * esc.dt),
            math.exp(-self.omega_g * esc.dt),
            self.logarithm,
            esc.dt,
            esc.theta_min,
            esc.theta_max,
        )


def initial(esc: EscConfig) -> PerturbationState:
    """Return the state before the first sample."""
    return PerturbationState(esc.theta_initial, esc.theta_initial, 0.0, 0.0, 0)


@njit()
def step(p: PerturbationParams, state: PerturbationState, r: float) -> PerturbationState:
    """Process one cost sample; ``theta`` of the returned state is the control input.

    The first sample only starts the washout.
    """
    cost = math.log(max(r, FLOOR)) if p.logarithm else r
    if state.k < 2:  # the detector's first answer is 0 by definition
        return PerturbationState(state.centre, state.theta, cost, 0.0, state.k + 1)
    dither = math.sin(p.omega * state.k * p.dt)
    slow_cost = p.alpha_w * state.slow_cost + (1.0 - p.alpha_w) * cost
    gradient = p.alpha_g * state.gradient + (1.0 - p.alpha_g) * (cost - slow_cost) * dither
    centre = state.centre - p.gain * gradient * p.dt
    centre = min(max(centre, p.theta_min), p.theta_max)
    theta = min(max(centre + p.amplitude * dither, p.theta_min), p.theta_max)
    return PerturbationState(centre, theta, slow_cost, gradient, state.k + 1)
