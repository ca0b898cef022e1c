"""Oscillators as rigs; shares no code with the workspace's packages.

Every one is of second order with one control input theta, whose limit cycle is smallest at a theta*
that only the rig knows. It ages: ``--at 80:shift=2`` moves theta* by 2 from its first place,
``mode=1.3`` and ``disturbance=1.3`` the frequencies of the oscillation and of what is added to the
sensors to 1.3 times the first. Plain Python on purpose: nothing here is the code under test.
"""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from stand import Actuation, SimulatedRig, parse_rig, start

DT = 0.005  # usual time between two samples [s]
STEP = 0.01  # of the integration, at most [s]
START, STROKE = 2.0, 5.0  # of theta
DELAY, RATE = 0.02, 1.0  # of the actuator [s], [1/s]
State = tuple[float, float]
Derivative = Callable[[float, float, float, float], State]


@dataclass(frozen=True)
class Physics:
    """Physics and sensors of a rig."""

    derivative: Derivative
    """``derivative(t, x, y, theta)`` returns (dx/dt, dy/dt)."""
    start: State
    """Initial [x, y]."""
    disturbance: Callable[[float], float]
    """``disturbance(t)`` is added to both sensors, as the paper's interference is."""
    noise: float
    """Standard deviation of each sensor's noise."""
    resolution: float
    """Quantisation step of the sensors."""


def van_der_pol(
    mu: float, offset: float, theta_star: float, force: float, omega: float
) -> Derivative:
    """Return the forced Van der Pol oscillator of the paper (section 3), with its drift."""

    def derivative(t: float, x: float, y: float, theta: float) -> State:
        epsilon = 1.0 + math.sin(0.005 * t)
        size = 1.0 + (theta - theta_star) ** 2
        damping = epsilon * ((x - offset) ** 2 - size)
        return y, -damping * y - mu * mu * (x - offset) + force * math.sin(omega * t)

    return derivative


def two_tones(a1: float, w1: float, a2: float, w2: float) -> Callable[[float], float]:
    """Return a sum of two sines."""
    return lambda t: a1 * math.sin(w1 * t) + a2 * math.sin(w2 * t)


def galloping(theta_star: float) -> Derivative:
    """Return a square prism that gallops in the wind, with a tunable damper.

    Parkinson and Smith, "The square prism as an aeroelastic non-linear oscillator", Quarterly
    Journal of Mechanics and Applied Mathematics 17 (1964) 225-239, in the time tau = omega t:

        Y'' + Y = n A [(U - U0) Y' - B/(A U) Y'^3 + C/(A U^3) Y'^5 - D/(A U^5) Y'^7]

    with U0 = 2 beta / (n A) the wind speed at which galloping begins. A, B, C and D are theirs,
    from the measured side force. The mass parameter n belongs to a light model. The damper works
    best when it is tuned, at theta*: beta, and so U0, falls off to both sides as a resonance does.
    The state is [Y, Y'] in tenths of the prism's width.
    """
    a, b, c, d = 2.69, 168.0, 6270.0, 59900.0
    n, wind, omega = 0.05, 2.0, 6.0
    k1, k3 = n * a, n * b / wind
    k5, k7 = n * c / wind**3, n * d / wind**5

    def derivative(t: float, x: float, y: float, theta: float) -> State:
        onset = 1.75 / (1.0 + ((theta - theta_star) / 3.0) ** 2)
        v = 0.1 * y
        v2 = v * v
        force = v * (k1 * (wind - onset) - v2 * (k3 - v2 * (k5 - v2 * k7)))
        return omega * y, omega * (10.0 * force - x)

    return derivative


RIGS = {
    "paper": Physics(
        van_der_pol(1.0, 6.0, -3.0, 2.2, 4.5),
        (1.0, -2.0),
        two_tones(10.5, 3.2, 11.1, 7.8),
        noise=0.02,
        resolution=0.01,
    ),
    "other": Physics(
        van_der_pol(1.3, 4.0, 1.5, 1.5, 5.2),
        (0.5, 1.0),
        two_tones(6.0, 2.6, 8.0, 9.1),
        noise=0.05,
        resolution=0.02,
    ),
    "galloping": Physics(
        galloping(0.8), (0.5, 0.0), two_tones(0.5, 2.0, 0.5, 15.0), noise=0.02, resolution=0.01
    ),
}


def advance(physics: Physics, t: float, dt: float, state: State, theta: float) -> State:
    """Integrate one step [s] with the classical Runge-Kutta method."""
    x, y = state
    f = physics.derivative
    ax, ay = f(t, x, y, theta)
    bx, by = f(t + dt / 2, x + dt / 2 * ax, y + dt / 2 * ay, theta)
    cx, cy = f(t + dt / 2, x + dt / 2 * bx, y + dt / 2 * by, theta)
    dx, dy = f(t + dt, x + dt * cx, y + dt * cy, theta)
    return x + dt / 6 * (ax + 2 * bx + 2 * cx + dx), y + dt / 6 * (ay + 2 * by + 2 * cy + dy)


class Oscillator(SimulatedRig):
    """One of :data:`RIGS` with its sensors, noisy and quantised."""

    message, topics = "MeasuredState", ("state", "theta")

    def __init__(self, args: argparse.Namespace) -> None:
        self._name, self._physics = args.rig, RIGS[args.rig]
        self.dt, self._slow = args.dt, args.slow
        self._steps = math.ceil(self.dt / self._slow / STEP)
        self._x = self._physics.start
        self._age = {"shift": 0.0, "mode": 1.0, "disturbance": 1.0}
        self._ahead = {"mode": 0.0, "disturbance": 0.0}  # of the time, for it went faster [s]
        self.actuations = [Actuation(*start(args, START), -STROKE, STROKE, DELAY, RATE)]

    def measure(self, t: float, rng: random.Random) -> tuple[list[float], State]:
        """Return what the sensors say at a time [s], and the true state."""
        physics = self._physics
        added = physics.disturbance(t / self._slow + self._ahead["disturbance"])
        noisy = (value + added + rng.gauss(0.0, physics.noise) for value in self._x)
        return [round(value / physics.resolution) * physics.resolution for value in noisy], self._x

    def advance(self, t: float, theta: float) -> None:
        """Go on by one sample."""
        theta, mode = theta - self._age["shift"], self._age["mode"]
        begin, span = t / self._slow + self._ahead["mode"], self.dt / self._slow
        step = mode * span / self._steps
        for i in range(self._steps):
            self._x = advance(self._physics, begin + i * step, step, self._x, theta)
        for name in self._ahead:
            self._ahead[name] += (self._age[name] - 1.0) * span
        if not math.isfinite(self._x[0] + self._x[1]):
            raise ValueError(f"{self._name} broke at t = {t:g} s")

    def set(self, name: str, value: float) -> None:
        """Age: move the optimum or a frequency."""
        if name not in self._age:
            super().set(name, value)
        self._age[name] = value


def register(rigs: Any) -> None:
    """Add them to the command line."""
    for name, physics in sorted(RIGS.items()):
        words = physics.derivative.__qualname__.split(".")[0].replace("_", " ")
        parser = parse_rig(rigs, name, f"{words}, on our own types", Oscillator)
        parser.add_argument("--dt", type=float, default=DT, help="between two samples [s]")
        parser.add_argument("--slow", type=float, default=1.0, help="its times are as many as long")
