"""The true static map of a rig: its amplitudes at values of theta that are held."""

from __future__ import annotations

import argparse
import math
import random

import numpy as np
from stand import SimulatedRig

SAMPLES = 60_000  # at each value, unless a duration is wanted
SETTLING = 1.0 / 3.0  # of them


def true_amplitudes(rig: SimulatedRig, samples: int) -> np.ndarray:
    """Return sqrt(2) times the standard deviation of each number of the true state.

    Theta is held where it is at first.
    """
    rng, truth, theta = random.Random(0), [], [actuation.start for actuation in rig.actuations]
    for k in range(samples):
        truth.append(rig.measure(k * rig.dt, rng)[1])
        rig.advance(k * rig.dt, *theta)
    return math.sqrt(2.0) * np.std(truth[round(SETTLING * samples) :], axis=0)


def print_map(args: argparse.Namespace) -> None:
    """Print the map of a rig of the command line."""
    low, high, points = args.map
    print("     theta  true amplitude")
    for theta in np.linspace(low, high, round(points)):
        args.theta_initial[:1] = [float(theta)]
        rig: SimulatedRig = args.make(args)
        samples = round(args.duration / rig.dt) or SAMPLES
        values = true_amplitudes(rig, samples)
        print(*(f"{value:10.4g}" for value in (theta, *values)), flush=True)
