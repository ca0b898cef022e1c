"""Forced, time-varying Van der Pol oscillator and its measurement (paper section 3).

    x' = y
    y' = -epsilon0(t) [(x - x0)^2 - 1 - (theta - theta*)^2] y - mu^2 (x - x0) + f(t)

    epsilon0(t) = epsilon0 + drift sin(omega_d t),   f(t) = A_f sin(omega_f t)
    x'(t) = x(t) + i(t),  i(t) = A1 sin(omega_1 t + phi_1) + A2 sin(omega_2 t + phi_2)

:func:`advance` is one step of the plant: the actuator's bounds and rate, then the integrator. The
node calls it once a step; offline loop, study, training and benchmark inline it: a run over DDS and
an offline run agree bit for bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit


class PlantParams(NamedTuple):
    """Scalars of the kernels; units and defaults as in ``vdp_plant.config.PlantConfig``."""

    epsilon0: float
    epsilon0_drift: float
    drift_frequency: float
    forcing_amplitude: float
    forcing_frequency: float
    mu: float
    x_offset: float
    theta_star: float
    interference_amplitude_1: float
    interference_frequency_1: float
    interference_phase_1: float
    interference_amplitude_2: float
    interference_frequency_2: float
    interference_phase_2: float
    dt: float
    theta_min: float
    theta_max: float
    theta_rate: float


class PlantKnobs(NamedTuple):
    """Several knobs: arrays of shape (n,), and the coupling M, shape (n, n)."""

    theta_min: NDArray[np.float64]
    theta_max: NDArray[np.float64]
    theta_rate: NDArray[np.float64]
    theta_star: NDArray[np.float64]
    coupling: NDArray[np.float64]


@njit()
def damping(p: PlantParams, t: float) -> float:
    """Return epsilon0(t) [-] at time ``t`` [s]."""
    return p.epsilon0 + p.epsilon0_drift * math.sin(p.drift_frequency * t)


@njit()
def forcing(p: PlantParams, t: float) -> float:
    """Return f(t) [1/s^2] at time ``t`` [s]."""
    return p.forcing_amplitude * math.sin(p.forcing_frequency * t)


@njit()
def acceleration(
    p: PlantParams, eps: float, force: float, x: float, y: float, theta: float
) -> float:
    """Return dy/dt [1/s^2] for damping ``eps`` and forcing ``force`` of that instant."""
    offset = x - p.x_offset
    detuning = theta - p.theta_star
    return -eps * (offset * offset - 1.0 - detuning * detuning) * y - p.mu * p.mu * offset + force


@njit()
def step(p: PlantParams, k: int, x: float, y: float, theta: float) -> tuple[float, float]:
    """Integrate the true state over step k, theta held, without the actuator.

    Returns x and y at t_{k+1}; not finite if the integration diverges.
    """
    h = p.dt
    t, half = k * h, 0.5 * h
    eps0, force0 = damping(p, t), forcing(p, t)
    eps1, force1 = damping(p, t + half), forcing(p, t + half)
    eps2, force2 = damping(p, t + h), forcing(p, t + h)
    k1x = y
    k1y = acceleration(p, eps0, force0, x, y, theta)
    k2x = y + half * k1y
    k2y = acceleration(p, eps1, force1, x + half * k1x, k2x, theta)
    k3x = y + half * k2y
    k3y = acceleration(p, eps1, force1, x + half * k2x, k3x, theta)
    k4x = y + h * k3y
    k4y = acceleration(p, eps2, force2, x + h * k3x, k4x, theta)
    sixth = h / 6.0
    return (
        x + sixth * (k1x + 2.0 * k2x + 2.0 * k3x + k4x),
        y + sixth * (k1y + 2.0 * k2y + 2.0 * k3y + k4y),
    )


@njit()
def limit(theta: float, applied: float, low: float, high: float, most: float) -> float:
    """Return theta within bounds, and no further from what was applied than ``most``."""
    theta = min(max(theta, low), high)
    return min(max(theta, applied - most), applied + most)


@njit()
def advance(
    p: PlantParams, k: int, x: float, y: float, applied: float, theta: float
) -> tuple[float, float, float]:
    """Advance the plant by one step under a commanded theta: actuate, then integrate.

    ``applied`` is the theta that acted in the step before. The actuator's bounds and rate hold for
    any source of commands; the controller has limits of its own. Returns x and y at t_{k+1} and the
    theta that acted.
    """
    applied = limit(theta, applied, p.theta_min, p.theta_max, p.theta_rate * p.dt)
    x, y = step(p, k, x, y, applied)
    return x, y, applied


@njit()
def distance(
    coupling: NDArray[np.float64], theta: NDArray[np.float64], theta_star: NDArray[np.float64]
) -> float:
    """Return |M (theta - theta*)|."""
    square = 0.0
    for i in range(theta.size):
        e = 0.0
        for j in range(theta.size):
            e += coupling[i, j] * (theta[j] - theta_star[j])
        square += e * e
    return math.sqrt(square)


@njit()
def advance_knobs(
    p: PlantParams,
    knobs: PlantKnobs,
    k: int,
    x: float,
    y: float,
    applied: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> tuple[float, float]:
    """Advance a plant with several knobs as :func:`advance` does; ``applied`` is changed.

    |M (theta - theta*)| takes the place of theta - theta*.
    """
    for i in range(applied.size):
        most = knobs.theta_rate[i] * p.dt
        applied[i] = limit(theta[i], applied[i], knobs.theta_min[i], knobs.theta_max[i], most)
    seen = p.theta_star + distance(knobs.coupling, applied, knobs.theta_star)
    return step(p, k, x, y, seen)


@njit()
def interference(p: PlantParams, k: int) -> float:
    """Return i(t_k), which the sensor adds to every component of the state."""
    t = k * p.dt
    return p.interference_amplitude_1 * math.sin(
        p.interference_frequency_1 * t + p.interference_phase_1
    ) + p.interference_amplitude_2 * math.sin(
        p.interference_frequency_2 * t + p.interference_phase_2
    )


@njit()
def measure(p: PlantParams, k: int, x: float, y: float) -> tuple[float, float]:
    """Return the measured state x'(t_k) = x(t_k) + i(t_k), both components corrupted."""
    disturbance = interference(p, k)
    return x + disturbance, y + disturbance


def initial_state(seed: int) -> NDArray[np.float64]:
    """Draw [x(0), y(0)], shape (2,), from a seed: uniform in [-3, 3], as in the training."""
    return np.random.default_rng(seed).uniform(-3.0, 3.0, size=2)
