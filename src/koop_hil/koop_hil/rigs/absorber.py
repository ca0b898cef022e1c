"""A structure that oscillates by itself, with a tuned mass damper: a deep, narrow valley in theta.

Theta is the damper's natural frequency as a fraction of the structure's. Within a few per cent of
the right one the damper takes more energy than the structure is fed, and only what chance forces
excite is left; beside it the amplitude is a limit cycle's at once. Near the edges of the
valley the oscillation grows and decays slowly.
"""

from __future__ import annotations

import argparse
import math
import random
from typing import Any

from stand import Actuation, SimulatedRig, parse_rig, start

DT, STEPS = 0.02, 4  # between two samples [s]; steps of the integration within
OMEGA = 2.0 * math.pi * 1.1  # of the structure alone [rad/s]
FED, LOST = 0.01, 0.02  # negative damping ratio of the structure, damping ratio of the damper
MASS = 0.008  # of the damper, as a fraction of the structure's
LIMIT = 0.45  # displacement at which the structure is fed nothing any more; half its limit cycle
FORCE = 0.04  # chance force, spectral density [1/s^1.5]
SHAPE = (1.0, 0.6)  # displacement of the two sensors, as a fraction of the structure's
WAVES, WAVE = (1.6, 1.3), 2.0 * math.pi * 0.13  # interference of the sensors; frequency [rad/s]
NOISE = 0.02  # of the sensors, standard deviation


class Absorber(SimulatedRig):
    """Structure and damper in modal coordinates: x, x' and z, z', displacements in cm.

    With w = OMEGA and the force f = theta^2 w^2 (z - x) + 2 LOST theta w (z' - x') per mass of
    the damper (Den Hartog, "Mechanical Vibrations", section 3.3, with Van der Pol's self-excitation
    in place of the harmonic force)::

        x'' = 2 FED w (1 - (x / LIMIT)^2) x' - w^2 x + MASS f + FORCE white noise
        z'' = -f
    """

    dt, message, topics = DT, "JointState", ("structure", "absorber")

    def __init__(self, args: argparse.Namespace) -> None:
        self.actuations = [Actuation(*start(args, 0.7), 0.5, 1.6, delay=0.1, rate=0.1)]
        self._state = (LIMIT, 0.0, 0.0, 0.0)
        self._random = random.Random(args.seed + 1)  # not the sensors' numbers again

    def measure(self, t: float, rng: random.Random) -> tuple[list[float], list[float]]:
        """Return what the two sensors say, and the structure's true displacement."""
        wave, x = math.sin(WAVE * t), self._state[0]
        sensors = zip(SHAPE, WAVES, strict=True)
        return [a * x + b * wave + rng.gauss(0.0, NOISE) for a, b in sensors], [x]

    def advance(self, t: float, theta: float) -> None:
        """Go on by one sample: semi-implicit Euler, which neither feeds nor damps."""
        x, v, z, u = self._state
        h, push = DT / STEPS, FORCE * self._random.gauss(0.0, 1.0) / math.sqrt(DT)
        stiffness, damping = (theta * OMEGA) ** 2, 2.0 * LOST * theta * OMEGA
        for _ in range(STEPS):
            force = stiffness * (z - x) + damping * (u - v)
            fed = 2.0 * FED * OMEGA * (1.0 - (x / LIMIT) ** 2)
            v += h * (fed * v - OMEGA**2 * x + MASS * force + push)
            u -= h * force
            x += h * v
            z += h * u
        self._state = (x, v, z, u)


def register(rigs: Any) -> None:
    """Add it to the command line."""
    text = "a self-excited structure with a tuned mass damper, a deep and narrow valley"
    parse_rig(rigs, "absorber", text, Absorber)
