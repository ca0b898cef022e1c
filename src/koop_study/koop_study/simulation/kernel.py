"""The study's closed loop: the nodes' kernels under a scenario and one of several controllers.

Plant, cost and relay are the functions that the nodes call, with every setting that they have. The
scenario disturbs what the nodes would hear: a lost state is not answered, and steps tell what
follows on a silence. Two things are the study's own: the logarithm of an energy, and the other
controllers, which hold and resume where the relay does. Without a scenario and with the relay this
is ``koop_loop.loop.run_kernel`` to the last bit; a test holds the two together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import borrowed, njit
from koop_core.stream.arrival import NOTHING
from koop_loop.kernel import classify
from koop_study.controllers import adaptive, perturbation
from koop_study.controllers.adaptive import AdaptiveParams, AdaptiveState
from koop_study.controllers.perturbation import PerturbationParams, PerturbationState
from koop_study.simulation.scenario import Exposure
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, Lifting, Workspace
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState
from vdp_plant import waves
from vdp_plant.dynamics import PlantParams

RELAY = 0
ADAPTIVE = 1
PERTURBATION = 2
CONTROLLERS = {"relay": RELAY, "adaptive": ADAPTIVE, "perturbation": PERTURBATION}
FLOOR = 1e-12  # of an energy before its logarithm


class Sensing(NamedTuple):
    """What makes the cost: source RAW or LIFTED, optionally the logarithm of the energy.

    ``timeout`` is the silence after which the state resumes [s]; 0: never. ``channels`` are the
    measured states; ``work`` is of one run.
    """

    source: int
    logarithm: bool
    lifting: Lifting
    detector: DetectorParams
    timeout: float
    channels: NDArray[np.int64]
    work: Workspace


class Control(NamedTuple):
    """Parameters and states of every controller; ``kind`` says which one acts.

    ``timeout`` is the silence after which the cost resumes [s]; 0: never.
    """

    kind: int
    timeout: float
    relay: RelayParams
    relay_state: RelayState
    adaptive: AdaptiveParams
    adaptive_state: AdaptiveState
    perturbation: PerturbationParams
    perturbation_state: PerturbationState


@njit()
def run_kernel(
    plant: PlantParams,
    sensing: Sensing,
    control: Control,
    exposure: Exposure,
    x: float,
    y: float,
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
    ground_truth: NDArray[np.float64],
) -> int:
    """Run ``theta.size`` steps; fill ``r``, ``theta`` and, unless empty, ``ground_truth``.

    Returns
    -------
    int
        Steps done; fewer than asked for only if the plant's state stops being finite.
    """
    kind = control.kind
    relay_state = control.relay_state
    adaptive_state = control.adaptive_state
    perturbation_state = control.perturbation_state
    detector_state = cost.initial()
    states = costs = NOTHING
    source, lifting, channels, work = (
        sensing.source, sensing.lifting, sensing.channels, sensing.work
    )  # fmt: skip
    lifting, work = cost.borrow(lifting, work)
    state, owner = np.empty(2), np.empty(channels.shape[0])
    sensed = borrowed(owner)
    now_r, now_theta = 0.0, relay_state.output
    applied = now_theta
    if exposure.schedule.shape[0] > 0:  # the actuator rests where the schedule begins
        applied = min(max(exposure.schedule[0], plant.theta_min), plant.theta_max)
    for k in range(theta.shape[0]):
        if not (math.isfinite(x) and math.isfinite(y)):
            return k
        state[0], state[1] = waves.measure(plant, exposure.waves, k, x, y)
        if exposure.added.shape[0] > 0:
            state[0] += exposure.added[k, 0]
            state[1] += exposure.added[k, 1]
        if exposure.lost.shape[0] == 0 or not exposure.lost[k]:
            state_arrival, states = classify(states, k, sensing.timeout, plant.dt)
            cost_arrival, costs = classify(costs, k, control.timeout, plant.dt)
            for i in range(channels.shape[0]):
                sensed[i] = state[channels[i]]
            y_out, filling = cost.energy(source, lifting, state_arrival, k, sensed, work)
            if sensing.logarithm:
                y_out = math.log(FLOOR if y_out < FLOOR else y_out)
            now_r, detector_state = cost.follow(
                sensing.detector, detector_state, state_arrival, y_out
            )
            if kind == RELAY:
                relay_state, _, _ = relay.answer(
                    control.relay, relay_state, cost_arrival, False, filling, now_r, False
                )
                now_theta = relay_state.output
            else:
                if kind == ADAPTIVE:
                    adaptive_state = adaptive.answer(
                        control.adaptive, adaptive_state, cost_arrival, now_r
                    )
                    wanted = adaptive_state.theta
                else:
                    if math.isfinite(now_r):
                        perturbation_state = perturbation.step(
                            control.perturbation, perturbation_state, now_r
                        )
                    wanted = perturbation_state.theta
                now_theta = relay.slew(now_theta, wanted, control.relay.largest_change)
        if exposure.schedule.shape[0] > 0:
            now_theta = exposure.schedule[k]
        r[k] = now_r
        theta[k] = now_theta
        if ground_truth.shape[0] > 0:
            ground_truth[k, 0] = x
            ground_truth[k, 1] = y
        displaced = exposure.displaced[k] if exposure.displaced.shape[0] > 0 else 0.0
        x, y, applied = waves.advance(plant, exposure.waves, k, x, y, applied, now_theta, displaced)
    owner[:] = 0.0  # there to here
    return theta.shape[0]
