"""The closed loop offline: the nodes' kernels composed in one compiled function, without ROS.

Events have the order of the nodes in lockstep. At step k the plant publishes x'(t_k), the lifter
answers with r_k, the relay with theta_k, and the plant then advances with theta_k. Nothing is late
or lost, so no timeout acts; every other setting does what it does in the nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.errors import InputError, KoopError
from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_loop.kernel import Controller, LoopMemory
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.cost import Workspace
from koopman_lifter.model import KoopmanModel
from relay_esc import directions, relay
from relay_esc.config import EscConfig
from relay_esc.directions import Knobs
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantKnobs, PlantParams


class LoopDiverged(KoopError, ArithmeticError):
    """The plant's state left the finite numbers; the message says when."""


@dataclass(frozen=True)
class LoopResult:
    """Signals of one closed loop, one row a step."""

    dt: float
    """Step [s]; step k is at t = k dt."""
    measured: NDArray[np.float64]
    """Shape (M, 2): x'(t_k)."""
    ground_truth: NDArray[np.float64]
    """Shape (M, 2): x(t_k)."""
    r: NDArray[np.float64]
    """Shape (M,): cost."""
    theta: NDArray[np.float64]
    """Shape (M,): control input; of n > 1 knobs of shape (M, n)."""

    @property
    def step(self) -> NDArray[np.int64]:
        """Step index k, shape (M,)."""
        return np.arange(self.r.size)

    @property
    def t(self) -> NDArray[np.float64]:
        """Time [s], shape (M,)."""
        return np.asarray(self.step * self.dt, dtype=np.float64)


@njit()
def run_kernel(
    plant: PlantParams,
    plant_knobs: PlantKnobs | None,
    controller: Controller,
    knobs: Knobs | None,
    first: float | None,
    memory: LoopMemory,
    work: Workspace,
    x: float,
    y: float,
    measured: NDArray[np.float64],
    ground_truth: NDArray[np.float64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> int:
    """Run the loop for M steps and fill the four arrays; return the steps done.

    Fewer than asked for are done only if the plant's state stops being finite. ``first`` is the
    theta of one knob, ``plant_knobs`` and ``knobs`` are of several; what is None the compiler
    leaves out.
    """
    states = borrowed(measured)
    source, lifting, detector_params, relay_params = controller
    lifting, work = borrowed(lifting), borrowed(work)
    detector = memory.detector
    command: Any = memory.relay
    applied: Any
    if first is not None:
        applied = first
    if knobs is not None:
        applied = command.theta.copy()
    for k in range(r.shape[0]):
        if not (math.isfinite(x) and math.isfinite(y)):
            return k
        state = states[k]
        arrival = Arrival.RESTART if k == 0 else Arrival.NEXT
        state[0], state[1] = dynamics.measure(plant, k, x, y)
        ground_truth[k, 0], ground_truth[k, 1] = x, y
        r[k], _, settling, detector = cost.answer(
            source, lifting, detector_params, detector, arrival, k, state, work
        )
        if first is not None:
            command, _, _ = relay.answer(
                relay_params, command, arrival, False, settling, r[k], False
            )
            theta[k] = command.output
            x, y, applied = dynamics.advance(plant, k, x, y, applied, theta[k])
        if knobs is not None:
            command, _, _ = directions.answer(
                relay_params, knobs, command, arrival, False, settling, r[k], False
            )
            for i in range(command.theta.size):  # assigning arrays takes seconds to compile
                theta[k, i] = command.theta[i]
            x, y = dynamics.advance_knobs(plant, plant_knobs, k, x, y, applied, command.theta)
    return len(r)


def controller(lifter: LifterConfig, esc: EscConfig, model: KoopmanModel | None) -> Controller:
    """Return the kernel's parameters of lifter and controller."""
    lifting = model.lifting() if model is not None else cost.no_lifting()
    return Controller(
        lifter.source, lifting, lifter.detector_params(), esc.knob(0).params(lifter.dt)
    )


def initial_state(plant: PlantConfig) -> tuple[float, float]:
    """Return the plant's [x(0), y(0)]: as configured, else drawn from the seed."""
    x, y = plant.initial_state or dynamics.initial_state(plant.seed)
    return float(x), float(y)


def simulate(
    plant: PlantConfig,
    lifter: LifterConfig,
    esc: EscConfig,
    model: KoopmanModel | None,
    steps: int,
) -> LoopResult:
    """Run a closed loop offline, for so many control steps; the lifted cost alone needs a model.

    Raises
    ------
    koop_core.errors.InputError
        If the lifted cost has no model, or the model or the step sizes do not fit together.
    LoopDiverged
        If the plant's state stops being finite.
    """
    check_fit(plant, lifter, esc, model)
    x, y = initial_state(plant)
    measured, ground_truth = np.empty((steps, 2)), np.empty((steps, 2))
    r, theta = np.empty(steps), np.empty(steps if esc.count == 1 else (steps, esc.count))
    parameters, signals = controller(lifter, esc, model), (measured, ground_truth, r, theta)
    work = cost.workspace(parameters.lifting)
    several = esc.count > 1
    plant_knobs = plant.knob_params() if several else None
    knobs = esc.knob_limits(plant.dt) if several else None
    begin = esc.initial_directions() if several else esc.initial()
    memory = LoopMemory(cost.initial(), begin)
    first = None if several else memory.relay.output
    done = run_kernel(
        plant.params(), plant_knobs, parameters, knobs, first, memory, work, x, y, *signals
    )
    if done < steps:
        raise LoopDiverged(f"the plant diverged at t = {done * plant.dt:g} s: use a smaller dt")
    return LoopResult(plant.dt, measured, ground_truth, r, theta)


def check_fit(
    plant: PlantConfig, lifter: LifterConfig, esc: EscConfig, model: KoopmanModel | None
) -> None:
    """Raise InputError unless the three configurations and the model belong together."""
    if plant.dt != lifter.dt:
        raise InputError(f"dt differs: plant {plant.dt}, lifter {lifter.dt} s")
    if plant.count != esc.count:
        raise InputError(f"the plant has {plant.count} knobs, the controller {esc.count}")
    if plant.each("theta_initial") != esc.each("theta_initial"):
        raise InputError(
            f"theta_initial differs: plant {plant.theta_initial}, esc {esc.theta_initial}"
        )
    if model is None:
        if lifter.cost == "lifted":
            raise InputError("the lifted cost needs a model")
        return
    if model.delays.channels != 2:
        raise InputError(f"the model is for {model.delays.channels} channels, the plant gives 2")
    if model.dt != plant.dt:
        raise InputError(f"the model was trained at dt = {model.dt} s, the loop runs at {plant.dt}")
