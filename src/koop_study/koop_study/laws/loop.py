"""The closed loop of any law on any plant: the lifter's kernel between them, compiled.

A law sees costs and says u, the position of theta in its range (of log theta on a rig with a log
scale): constants in units of u serve every rig. Plants are the paper's oscillator and the rigs of
the family; both have two states. The paper's run begins with the plant; a rig is under way, and the
detector and the relay join it as the nodes do. Laws that weigh the cost are given log r, which no
unit of r matters to, and nothing before the detector has settled; the relay, which sees only how r
goes, is given r and does what the node does.

The loop can be left after any step and gone on with: a law that is not compiled holds u between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import borrowed, njit
from koop_core.stream.arrival import NOTHING, Heard
from koop_loop.kernel import classify
from koop_study.controllers import perturbation
from koop_study.controllers.perturbation import PerturbationParams, PerturbationState
from koop_study.family import oscillator
from koop_study.family.oscillator import RigParams, RigState
from koop_study.laws import bounded, golden, least_squares, newton, sliding, stochastic
from koop_study.simulation.scenario import Exposure
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting, Workspace
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState
from vdp_plant import waves
from vdp_plant.dynamics import PlantParams

HOLD, RELAY, PERTURBATION, NEWTON, LEAST_SQUARES, BOUNDED, SLIDING, STOCHASTIC, GOLDEN = range(9)
MEMORY = 16  # numbers that a law may remember
FLOOR = 1e-300  # of r before its logarithm


class Sensing(NamedTuple):
    """What makes the cost, see :mod:`koopman_lifter.cost`; ``work`` is of one run.

    ``timeout`` is the silence after which state and cost resume [s]; ``sense`` is +1 where r is to
    be minimised.
    """

    source: int
    lifting: Lifting
    detector: DetectorParams
    timeout: float
    sense: float
    work: Workspace


class Law(NamedTuple):
    """Which law acts, with its constants: the relay's apart, ``p`` in the order of its module."""

    kind: int
    relay: RelayParams
    p: NDArray[np.float64]


class LoopState(NamedTuple):
    """What a loop remembers between two steps, but for the arrays: the law's, the delay line."""

    first: float
    second: float
    applied: float
    detector: DetectorState
    relay: RelayState
    u: float
    states: Heard
    costs: Heard


def initial(first: float, second: float, theta: float, u: float, joins: RelayState) -> LoopState:
    """Return the state before the first step: of the plant, theta, and u."""
    return LoopState(first, second, theta, cost.initial(), joins, u, NOTHING, NOTHING)


def memory(u: float) -> NDArray[np.float64]:
    """Return what a law remembers before its first cost: where it is, in its first place."""
    found = np.zeros(MEMORY)
    found[0] = u
    return found


@njit()
def answer(
    kind: int, p: NDArray[np.float64], m: NDArray[np.float64], dt: float, u: float, j: float
) -> float:
    """Return u after one cost; every law but the relay, whose kernel has a state of its own."""
    if kind == PERTURBATION:
        alpha_w, alpha_g = math.exp(-p[3] * dt), math.exp(-p[4] * dt)
        params = PerturbationParams(p[0], p[1], p[2], alpha_w, alpha_g, False, dt, 0.0, 1.0)
        state = PerturbationState(m[0], u, m[1], m[2], int(m[3]))
        after = perturbation.step(params, state, j)
        m[0], m[1], m[2], m[3] = after.centre, after.slow_cost, after.gradient, float(after.k)
        return after.theta
    if kind == NEWTON:
        return newton.step(p, m, dt, j)
    if kind == LEAST_SQUARES:
        m[least_squares.U] = u
        return least_squares.step(p, m, dt, j)
    if kind == BOUNDED:
        return bounded.step(p, m, dt, j)
    if kind == SLIDING:
        return sliding.step(p, m, dt, j)
    if kind == STOCHASTIC:
        return stochastic.step(p, m, dt, j)
    if kind == GOLDEN:
        return golden.step(p, m, dt, j)
    return u


@njit()
def drive(
    is_rig: bool,
    plant: PlantParams,
    exposure: Exposure,
    rig: RigParams,
    noise: NDArray[np.float64],
    sensing: Sensing,
    law: Law,
    m: NDArray[np.float64],
    state: LoopState,
    first: int,
    last: int,
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
    amplitude: NDArray[np.float64],
) -> LoopState:
    """Run the steps ``first`` to ``last``; fill these rows of ``r``, ``theta`` and ``amplitude``.

    Parameters
    ----------
    is_rig : bool
        Whether the plant is ``rig`` with ``noise``, shape (M, 2 + n), or ``plant`` with
        ``exposure``.
    m : ndarray, shape (MEMORY,)
        The law's memory; written to.
    amplitude : ndarray, shape (M,)
        Receives \\|z\\| of a rig; of the paper's plant sqrt(1 + (theta - theta*)^2), which
        its limit cycle is proportional to.
    """
    a, b, applied, detector, relay_state, u, states, costs = state
    n = rig.offset.shape[0] if is_rig else 2
    owner = np.empty(n)
    x = borrowed(owner)
    dt = rig.dt if is_rig else plant.dt
    source = sensing.source
    lifting, work = cost.borrow(sensing.lifting, sensing.work)
    low, high = plant.theta_min, plant.theta_max
    now_r = 0.0
    for k in range(first, last):
        lost = False
        if is_rig:
            oscillator.measure(rig, RigState(a, b), k, noise[k, 2:], x)
        else:
            x[0], x[1] = waves.measure(plant, exposure.waves, k, a, b)
            if exposure.added.shape[0] > 0:
                x[0] += exposure.added[k, 0]
                x[1] += exposure.added[k, 1]
            lost = exposure.lost.shape[0] > 0 and exposure.lost[k]
        if not lost:
            heard = k + 1 if is_rig else k  # a rig is under way: its first step is not 0
            state_arrival, states = classify(states, heard, sensing.timeout, dt)
            cost_arrival, costs = classify(costs, heard, sensing.timeout, dt)
            now_r, _, settling, detector = cost.answer(
                source, lifting, sensing.detector, detector, state_arrival, heard, x, work
            )
            if law.kind == RELAY:
                relay_state, _, _ = relay.answer(
                    law.relay, relay_state, cost_arrival, False, settling, now_r, False
                )
                u = relay_state.output
            elif math.isfinite(now_r) and k >= sensing.detector.settling:
                j = sensing.sense * math.log(max(now_r, FLOOR))
                u = min(max(answer(law.kind, law.p, m, dt, u, j), 0.0), 1.0)
        r[k] = now_r
        if is_rig:
            theta[k] = oscillator.theta_at(rig, u)
            amplitude[k] = math.sqrt(a * a + b * b)
            a, b = oscillator.step(rig, RigState(a, b), k, theta[k], noise[k, 0], noise[k, 1])
        else:
            theta[k] = low + u * (high - low)
            displaced = exposure.displaced[k] if exposure.displaced.shape[0] > 0 else 0.0
            distance = theta[k] - displaced - plant.theta_star
            amplitude[k] = math.sqrt(1.0 + distance * distance)
            a, b, applied = waves.advance(
                plant, exposure.waves, k, a, b, applied, theta[k], displaced
            )
    owner[:] = 0.0  # there to here
    return LoopState(a, b, applied, detector, relay_state, u, states, costs)
