"""The loop closed on a rig of the family with the nodes' own configuration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_study.family import oscillator
from koop_study.family.knobs import KnobsRig, acting
from koop_study.family.oscillator import RigParams, RigState
from koop_study.family.rig import RandomRig
from koop_study.family.settings import FAMILY
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.cost import DetectorParams, Lifting, Workspace
from koopman_lifter.model import KoopmanModel
from relay_esc import directions
from relay_esc.config import EscConfig
from relay_esc.directions import DirectionState, Knobs
from relay_esc.relay import RelayParams


@dataclass(frozen=True)
class RigController:
    """Lifter and controller of a loop."""

    lifter: LifterConfig
    """Configuration of the detector."""
    esc: EscConfig
    """Configuration of the controller; theta's start is chosen by the run."""
    model: KoopmanModel | None = None
    """Model of the lifted cost; None for the raw one."""


@dataclass(frozen=True)
class RunNoise:
    """Noise and interference of a run, and the amplitude at the best fixed theta under them."""

    numbers: NDArray[np.float64]
    """Shape (M, 2 + n): standard normal numbers of the rig; noise and interference of its channels.
    """
    best: float
    """Root mean square of the amplitude over the second half at the best fixed theta."""


def exposed(p: RigParams) -> RigParams:
    """Return a rig whose interference is among the numbers of its noise."""
    n = p.offset.size
    none = np.zeros((0, n))
    return p._replace(noise=np.ones(n), tone=np.zeros(0), tone_amplitude=none, tone_phase=none)


def noise_of(rig: RandomRig, steps: int, seed: int) -> RunNoise:
    """Draw the numbers of a run of some steps; the amplitude belongs to its second half."""
    p = rig.params
    numbers = rig.noise(steps, seed)
    numbers[:, 2:] *= p.noise
    t = np.arange(steps) * p.dt
    for omega, size, phase in zip(p.tone, p.tone_amplitude, p.tone_phase, strict=True):
        numbers[:, 2:] += size * np.sin(omega * t[:, None] + phase)
    theta, _ = rig.best_fixed(steps * p.dt)
    resting = replace(rig, theta_initial=theta)
    x, amplitude = np.empty((steps, rig.channels)), np.empty(steps)
    path = np.full(steps, theta)
    oscillator.run(exposed(p), resting.initial(seed), 0, path, numbers, x, amplitude)
    return RunNoise(numbers, math.sqrt(float((amplitude[steps // 2 :] ** 2).mean())))


class ClosedRun(NamedTuple):
    """A loop that was closed on a rig."""

    ratio: float
    """True amplitude of the second half over that at the best fixed theta with the same noise (its
    inverse where it is to be large)."""
    x: NDArray[np.float64]
    """Shape (M, n): measured channels."""
    theta: NDArray[np.float64]
    """Shape (M,): the controller's; of n knobs (M, n)."""


def from_end(rig: RandomRig, end: int) -> RandomRig:
    """Return the rig at rest at the lower (0) or upper (1) end of theta's range."""
    return replace(rig, theta_initial=rig.params.theta_max if end else rig.params.theta_min)


def close(
    rig: RandomRig, controller: RigController, noise: RunNoise, seed: int,
    knobs: KnobsRig | None = None,
) -> ClosedRun:  # fmt: skip
    """Close the loop on a rig that has settled at its first theta; of several knobs, where it is.

    Of a rig with several knobs ``rig`` is what its theta leads to; the controller begins at its
    ``theta_initial``.
    """
    p, esc = rig.params, controller.esc
    m, best = (np.zeros((1, 1)), np.zeros(1)) if knobs is None else (knobs.m, knobs.best)
    if knobs is None:
        esc = replace(esc, theta_initial=rig.theta_initial)
    model = controller.model
    lifting = cost.no_lifting() if model is None else model.lifting()
    source = cost.RAW if model is None else cost.LIFTED
    power = np.empty(FAMILY.blocks)
    steps = noise.numbers.shape[0]
    x, theta = np.empty((steps, rig.channels)), np.empty((steps, esc.count))
    _close(
        exposed(p), source, lifting, cost.workspace(lifting), controller.lifter.detector_params(),
        esc.knob(0).params(p.dt), esc.knob_limits(p.dt), esc.initial_directions(), m, best,
        rig.initial(seed), noise.numbers, power, x, theta,
    )  # fmt: skip
    ratio = math.sqrt(float(power[FAMILY.blocks // 2 :].mean())) / noise.best
    return ClosedRun(
        ratio if p.sense > 0.0 else 1.0 / max(ratio, 1e-9),
        x,
        theta if esc.count > 1 else theta[:, 0],
    )


@njit()
def _close(
    p: RigParams,
    source: int,
    lifting: Lifting,
    work: Workspace,
    detector: DetectorParams,
    relay: RelayParams,
    limits: Knobs,
    command: DirectionState,
    m: NDArray[np.float64],
    best: NDArray[np.float64],
    state: RigState,
    noise: NDArray[np.float64],
    power: NDArray[np.float64],
    measured: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> None:
    """Fill in each block's mean square of the amplitude."""
    steps, blocks = noise.shape[0], power.shape[0]
    lifting, work = borrowed(lifting), borrowed(work)
    states = borrowed(measured)
    cost_state = cost.initial()
    power[:] = 0.0
    share = blocks / steps
    for k in range(steps):
        i = k * blocks // steps
        x = states[k]
        oscillator.measure(p, state, k, noise[k, 2:], x)
        arrival = Arrival.NEXT if k > 0 else Arrival.JOIN
        r, _, settling, cost_state = cost.answer(
            source, lifting, detector, cost_state, arrival, k + 1, x, work
        )
        command, _, _ = directions.answer(
            relay, limits, command, arrival, False, settling, r, False
        )
        for j in range(theta.shape[1]):
            theta[k, j] = command.theta[j]
        acts = theta[k, 0] if theta.shape[1] == 1 else acting(p, m, best, command.theta)
        power[i] += oscillator.energy(state) * share
        state = oscillator.step(p, state, k, acts, noise[k, 0], noise[k, 1])
