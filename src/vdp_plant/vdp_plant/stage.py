"""What the plant does with its thetas and its ticks: compiled, from DDS to DDS.

In lockstep it answers every theta with the next state; at the timed paces every tick publishes one,
and the theta that came last acts. What is not plain, the last step of a run and those at which the
plant looks whether all listeners keep up among it, is left to the node.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.clock import Clock, steady, system
from koop_core.kernels import njit
from koop_core.named_tuple import replace
from koop_core.port import (
    FAILED,
    IDLE,
    MORE,
    OTHER,
    PLAIN,
    Port,
    floats,
    half_word,
    receive,
    send,
    word,
)
from koop_core.stream import durations
from vdp_plant import dynamics, pacing
from vdp_plant.dynamics import PlantParams

WINDOW = 2500  # steps that may be on their way to a subscriber: half of what a writer keeps
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
THETA = ("step", *STAMP, "theta")
STATE = ("step", *STAMP, "x")
GROUND_TRUTH = (*STATE, "theta_applied", "theta_step", "epsilon0")
TICK = FAILED + 1
"""Reason to stop: a tick is due that is not plain."""
age, tick, count = njit()(pacing.age), njit()(pacing.tick), njit()(durations.add)


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
    simulated: bool
    """Whether stamps are of the plant's time, not of the system's."""
    clock: Clock
    period: float
    """Between two ticks [s]; 0 in lockstep."""
    sent: NDArray[np.float64]
    """Shape (KEPT,): as :func:`vdp_plant.pacing.age` takes it."""
    oldest: float
    """Age of a state [s] above which a theta that answers it is refused."""
    longest: float
    """Silence [s] after which the last theta acts no more as usual."""
    round_trips: NDArray[np.int64]
    behind: NDArray[np.int64]
    """Shape (SIZES,): from state to theta, and ticks behind their time; see
    :mod:`koop_core.stream.durations`."""


class PlantProgress(NamedTuple):
    """What changes: the step, x(t_k), and the theta of the last step, commanded and applied."""

    k: int
    x: float
    y: float
    theta: float
    applied: float
    answered: int
    """Step of the last theta; it has the ``stamp`` [s], and was ``heard`` [s]."""
    stamp: float
    heard: float
    round_trip: float
    """From the state to it [s]."""
    theta_step: int
    """Of the theta that acted in the last step."""
    due: float
    """When the next tick is [s]; never in lockstep."""
    late: int
    """Ticks that others have taken the place of."""


@njit()
def due(progress: PlantProgress) -> float:
    """Return when the next tick is [s]."""
    return progress.due


@njit()
def step_next(stage: PlantStage, progress: PlantProgress) -> tuple[int, PlantProgress]:
    """Take the next theta, or the next tick; return a reason to stop, or MORE."""
    got = receive(stage.input)
    if got == OTHER:
        return OTHER, progress
    if stage.period == 0.0:
        return answer(stage, progress) if got == PLAIN else (IDLE, progress)
    now = steady(stage.clock)
    if got == PLAIN:
        return hear(stage, progress, now)
    return advance_at(stage, progress, now) if now >= progress.due else (IDLE, progress)


@njit()
def answer(stage: PlantStage, progress: PlantProgress) -> tuple[int, PlantProgress]:
    """Advance under the theta of this step and publish: lockstep."""
    p, k, theta = stage.params, progress.k, floats(stage.input, 3, 1)[0]
    if word(stage.input, 0)[0] != k or not math.isfinite(theta):
        return OTHER, progress
    k += 1
    if k >= stage.steps or k % WINDOW == 0:
        return OTHER, progress
    x, y, applied = dynamics.advance(p, k - 1, progress.x, progress.y, progress.applied, theta)
    if not (math.isfinite(x) and math.isfinite(y)):
        return OTHER, progress
    if not publish(stage, k, round(k * p.dt * 1e9), x, y, applied, k - 1):
        return FAILED, progress
    return MORE, replace(progress, k=k, x=x, y=y, theta=theta, applied=applied)


@njit()
def hear(stage: PlantStage, progress: PlantProgress, now: float) -> tuple[int, PlantProgress]:
    """Take a theta that will act from the next tick on."""
    port = stage.input
    step, theta = word(port, 0)[0], floats(port, 3, 1)[0]
    trip = age(stage.sent, progress.k - 1, stage.period, step, now)
    if step != progress.answered + 1 or not (math.isfinite(theta) and trip <= stage.oldest):
        return OTHER, progress
    count(stage.round_trips, trip)
    stamp = half_word(port, 1)[0] + 1e-9 * half_word(port, 2)[0]
    return MORE, replace(
        progress, theta=theta, answered=step, stamp=stamp, heard=now, round_trip=trip
    )


@njit()
def advance_at(stage: PlantStage, progress: PlantProgress, now: float) -> tuple[int, PlantProgress]:
    """Publish the state of a tick, and advance under the theta that came last."""
    p, k, x, y = stage.params, progress.k, progress.x, progress.y
    finite = math.isfinite(x) and math.isfinite(y)
    if k + 1 >= stage.steps or not (finite and now - progress.heard <= stage.longest):
        return TICK, progress
    late, next_due = tick(progress.due, stage.period, now)
    count(stage.behind, now - progress.due)
    stage.sent[k % pacing.KEPT] = now
    stamp = round(k * p.dt * 1e9) if stage.simulated else system(stage.clock)
    if not publish(stage, k, stamp, x, y, progress.applied, progress.theta_step):
        return FAILED, progress
    x, y, applied = dynamics.advance(p, k, x, y, progress.applied, progress.theta)
    return MORE, replace(
        progress, k=k + 1, x=x, y=y, applied=applied, theta_step=progress.answered, due=next_due,
        late=progress.late + late,
    )  # fmt: skip


@njit()
def publish(
    stage: PlantStage, k: int, stamp: int, x: float, y: float, applied: float, theta_step: int
) -> bool:
    """Publish x'(t_k) first, for the loop waits for it, then the truth; return whether rcl did."""
    p, truth = stage.params, stage.ground_truth
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    for out in (stage.state, truth):
        word(out, 0)[0] = k
        half_word(out, 1)[0] = seconds
        half_word(out, 2)[0] = nanoseconds
    measured, true = floats(stage.state, 3, 2), floats(truth, 3, 2)
    measured[0], measured[1] = dynamics.measure(p, k, x, y)
    true[0], true[1] = x, y
    floats(truth, 4, 1)[0] = applied
    word(truth, 5)[0] = theta_step
    floats(truth, 6, 1)[0] = dynamics.damping(p, k * p.dt)
    return bool(send(stage.state) and send(truth))
