"""The study's closed loop: the nodes' kernels under a scenario and one of several controllers.

Without a scenario and with the relay this is ``koop_loop.loop.run_kernel`` to the last bit; a test
holds the two together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from koop_study.controllers import adaptive, perturbation
from koop_study.controllers.adaptive import AdaptiveParams, AdaptiveState
from koop_study.controllers.perturbation import PerturbationParams, PerturbationState
from koop_study.simulation.scenario import Exposure
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState
from vdp_plant import dynamics
from vdp_plant.dynamics import PlantParams

RELAY = 0
ADAPTIVE = 1
PERTURBATION = 2
CONTROLLERS = {"relay": RELAY, "adaptive": ADAPTIVE, "perturbation": PERTURBATION}
FLOOR = 1e-12  # of an energy before its logarithm


class Sensing(NamedTuple):
    """What makes the cost: source RAW or LIFTED, optionally the logarithm of the energy."""

    source: int
    logarithm: bool
    lifting: Lifting
    detector: DetectorParams


class Control(NamedTuple):
    """Parameters and states of every controller; ``kind`` says which one acts."""

    kind: int
    relay: RelayParams
    relay_state: RelayState
    adaptive: AdaptiveParams
    adaptive_state: AdaptiveState
    perturbation: PerturbationParams
    perturbation_state: PerturbationState


@njit(cache=True)
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
        Steps done; fewer than asked for only if the state stops being finite.
    """
    kind = control.kind
    relay_state = control.relay_state
    adaptive_state = control.adaptive_state
    perturbation_state = control.perturbation_state
    detector_state = DetectorState(0.0, 0.0, 0.0, False)
    z = np.empty(sensing.lifting.parent.shape[0])
    state = np.empty(2)
    now_r, now_theta = 0.0, relay_state.theta
    for k in range(theta.shape[0]):
        state[0], state[1] = dynamics.measure(plant, k, x, y)
        if exposure.added.shape[0] > 0:
            state[0] += exposure.added[k, 0]
            state[1] += exposure.added[k, 1]
        if exposure.lost.shape[0] == 0 or not exposure.lost[k]:
            y_out = cost.energy(sensing.source, sensing.lifting, state, z)
            if sensing.logarithm:
                y_out = math.log(max(y_out, FLOOR))
            now_r, detector_state = cost.detect(sensing.detector, detector_state, y_out)
            if not math.isfinite(now_r):
                return k
            if kind == RELAY:
                relay_state = relay.step(control.relay, relay_state, now_r)
                now_theta = relay_state.theta
            elif kind == ADAPTIVE:
                adaptive_state = adaptive.step(control.adaptive, adaptive_state, now_r)
                now_theta = adaptive_state.theta
            else:
                perturbation_state = perturbation.step(
                    control.perturbation, perturbation_state, now_r
                )
                now_theta = perturbation_state.theta
        if exposure.schedule.shape[0] > 0:
            now_theta = exposure.schedule[k]
        r[k] = now_r
        theta[k] = now_theta
        if ground_truth.shape[0] > 0:
            ground_truth[k, 0] = x
            ground_truth[k, 1] = y
        displaced = exposure.displaced[k] if exposure.displaced.shape[0] > 0 else 0.0
        x, y = dynamics.step(plant, k, x, y, now_theta - displaced)
    return theta.shape[0]
