"""What the plant in lockstep does with the theta that it waits for: compiled, from DDS to DDS.

What is not plain, the last step of a run and those at which the plant looks whether all listeners
keep up among it, is left to the node.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from koop_core.kernels import njit
from koop_core.port import FAILED, MORE, OTHER, PLAIN, Port, floats, half_word, receive, send, word
from vdp_plant import dynamics
from vdp_plant.dynamics import PlantParams

WINDOW = 2500  # steps that may be on their way to a subscriber: half of what a writer keeps
THETA = ("step", "theta")
STATE = ("step", "header.stamp.sec", "header.stamp.nanosec", "x")
GROUND_TRUTH = (*STATE, "theta_applied", "theta_step", "epsilon0")


class PlantStage(NamedTuple):
    """What stays the same."""

    input: Port
    state: Port
    ground_truth: Port
    """With the values ``THETA``, ``STATE`` and ``GROUND_TRUTH``."""
    params: PlantParams
    """Of the plant."""
    steps: float
    """Of the run; infinite without an end."""


class PlantProgress(NamedTuple):
    """What changes: the step, x(t_k), and the theta of the last step, commanded and applied."""

    k: int
    x: float
    y: float
    theta: float
    applied: float


@njit()
def step_next(stage: PlantStage, progress: PlantProgress) -> tuple[int, PlantProgress]:
    """Advance under the theta of this step and publish; return a reason to stop, or MORE."""
    port, p, k = stage.input, stage.params, progress.k
    got = receive(port)
    if got != PLAIN:
        return got, progress
    theta = floats(port, 1, 1)[0]
    if word(port, 0)[0] != k or not math.isfinite(theta):
        return OTHER, progress
    k += 1
    if k >= stage.steps or k % WINDOW == 0:
        return OTHER, progress
    x, y, applied = dynamics.advance(p, k - 1, progress.x, progress.y, progress.applied, theta)
    if not (math.isfinite(x) and math.isfinite(y)):
        return OTHER, progress
    seconds, nanoseconds = divmod(round(k * p.dt * 1e9), 1_000_000_000)
    for out in (stage.state, stage.ground_truth):
        word(out, 0)[0] = k
        half_word(out, 1)[0] = seconds
        half_word(out, 2)[0] = nanoseconds
    measured = floats(stage.state, 3, 2)
    measured[0], measured[1] = dynamics.measure(p, k, x, y)
    truth = stage.ground_truth
    true = floats(truth, 3, 2)
    true[0], true[1] = x, y
    floats(truth, 4, 1)[0] = applied
    word(truth, 5)[0] = k - 1
    floats(truth, 6, 1)[0] = dynamics.damping(p, k * p.dt)
    if not (send(stage.state) and send(truth)):
        return FAILED, progress
    return MORE, PlantProgress(k, x, y, theta, applied)
