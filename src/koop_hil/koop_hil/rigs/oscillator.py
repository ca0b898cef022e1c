"""The oscillators of :mod:`physics` as rigs."""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Callable
from typing import Any

from physics import RIGS, Rig, advance
from stand import Knob, Stand

DT = 0.005  # [s]
START, STROKE = 2.0, 5.0  # of theta
DELAY, RATE = 0.02, 1.0  # of the actuator [s], [1/s]


def register(rigs: Any, common: argparse.ArgumentParser) -> None:
    """Add them to the command line."""
    for name, rig in sorted(RIGS.items()):
        words = rig.derivative.__qualname__.split(".")[0].replace("_", " ")
        parser = rigs.add_parser(name, parents=[common], help=f"{words}, on our own types")
        parser.set_defaults(run=run)


def measure(rig: Rig, t: float, state: tuple[float, float], rng: random.Random) -> list[float]:
    """Return what the sensors say."""
    added = rig.disturbance(t)
    noisy = (value + added + rng.gauss(0.0, rig.noise) for value in state)
    return [round(value / rig.resolution) * rig.resolution for value in noisy]


def run(args: argparse.Namespace, begin: Callable[[Stand], Stand]) -> None:
    """Run one.

    Raises
    ------
    ValueError
        If it diverges.
    """
    from wire import MeasuredState, Wire, measured_state

    rig = RIGS[args.rig]
    state, theta = args.state or "state", args.theta or "theta"
    wire = Wire(state, theta, MeasuredState, measured_state, numbered=True)
    start = START if args.theta_initial is None else args.theta_initial
    stand = begin(Stand(args, wire, DT, Knob(start, -STROKE, STROKE, DELAY, RATE)))
    x = rig.start
    while True:
        t = stand.t
        theta = stand.exchange(measure(rig, t, x, stand.rng), x)
        if theta is None:
            return
        x = advance(rig, t, DT, x, theta)
        if not math.isfinite(x[0] + x[1]):
            raise ValueError(f"{args.rig} broke at t = {t:g} s")
