"""The closed loop offline: the nodes' kernels composed in one compiled function, without ROS.

Events have the order of the nodes in lockstep. At step k the plant publishes x'(t_k), the lifter
answers with r_k, the relay with theta_k, and the plant then advances with theta_k. Nothing is late
or lost, so no timeout acts; every other setting does what it does in the nodes.

A run can be disturbed (:class:`Exposure`): noise, states that never arrive, an optimum that moves,
a sensor of one state only. Without a disturbance the compiled loop has no trace of any.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.errors import InputError, KoopError
from koop_core.kernels import njit
from koop_core.stream.arrival import NOTHING, Arrival
from koop_loop.kernel import Controller, LoopMemory, classify, control, timeout_of
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.cost import Workspace
from koopman_lifter.model import KoopmanModel
from relay_esc import directions
from relay_esc.config import EscConfig
from relay_esc.directions import DirectionState, Knobs
from vdp_plant import dynamics, waves
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantKnobs, PlantParams
from vdp_plant.waves import Waves


class LoopDiverged(KoopError, ArithmeticError):
    """The plant's state left the finite numbers; the message says when."""


@dataclass(frozen=True)
class LoopResult:
    """Signals of one closed loop, one row a step.

    Attributes
    ----------
    dt : float
        Step [s]; step k is at t = k dt.
    measured : ndarray, shape (M, 2)
        x'(t_k).
    ground_truth : ndarray, shape (M, 2)
        x(t_k).
    r : ndarray, shape (M,)
        Cost.
    theta : ndarray, shape (M,)
        Control input; of n > 1 knobs of shape (M, n).
    """

    dt: float
    measured: NDArray[np.float64]
    ground_truth: NDArray[np.float64]
    r: NDArray[np.float64]
    theta: NDArray[np.float64]

    @property
    def step(self) -> NDArray[np.int64]:
        """Step index k, shape (M,)."""
        return np.arange(self.r.size)

    @property
    def t(self) -> NDArray[np.float64]:
        """Time [s], shape (M,)."""
        return np.asarray(self.step * self.dt, dtype=np.float64)


class Exposure(NamedTuple):
    """Disturbances of a run; an array of length 0 switches its disturbance off.

    Attributes
    ----------
    added : ndarray, shape (M, 2) or (0, 2)
        Added to the measured state.
    lost : ndarray of bool, shape (M,) or (0,)
        True where the measured state does not arrive: then nothing is answered.
    displaced : ndarray, shape (M,) or (0,)
        Displacement of theta* from its configured value.
    schedule : ndarray, shape (M,) or (0,)
        Control input that replaces the controller's.
    channels : ndarray of int, shape (n,)
        Components of the measured state that the lifter receives.
    waves : Waves
        Waves of the plant, for as many steps as are known beforehand.
    """

    added: NDArray[np.float64]
    lost: NDArray[np.bool_]
    displaced: NDArray[np.float64]
    schedule: NDArray[np.float64]
    channels: NDArray[np.int64]
    waves: Waves


@njit()
def run_kernel(
    plant: PlantParams,
    controller: Controller,
    memory: LoopMemory,
    work: Workspace,
    x: float,
    y: float,
    measured: NDArray[np.float64],
    ground_truth: NDArray[np.float64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
    exposure: Exposure | None,
) -> int:
    """Run the loop for ``theta.size`` steps and fill the four arrays; return the steps done.

    Fewer than asked for are done only if the plant's state stops being finite. With ``exposure``
    None the compiler leaves out all that it would do.
    """
    states = borrowed(measured)
    source, lifting, detector_params, relay_params = controller
    lifting, work = cost.borrow(lifting, work)
    detector, relay = memory
    applied = relay.output
    now_r, now_theta = 0.0, relay.output
    heard, timeout = NOTHING, timeout_of(plant.dt)
    if exposure is not None:
        owner = np.empty(exposure.channels.shape[0])
        received = borrowed(owner)
        if exposure.schedule.shape[0] > 0:  # the actuator rests where the schedule begins
            applied = min(max(exposure.schedule[0], plant.theta_min), plant.theta_max)
    for k in range(theta.shape[0]):
        if not (math.isfinite(x) and math.isfinite(y)):
            return k
        state = states[k]
        if exposure is None:
            arrival = Arrival.RESTART if k == 0 else Arrival.NEXT
            state[0], state[1] = dynamics.measure(plant, k, x, y)
            now_r, detector, relay = control(
                source, lifting, detector_params, relay_params, detector, relay,
                arrival, arrival, False, False, k, state, work,
            )  # fmt: skip
            now_theta = relay.output
            x_next, y_next, applied = dynamics.advance(plant, k, x, y, applied, now_theta, 0.0)
        else:
            state[0], state[1] = waves.measure(plant, exposure.waves, k, x, y)
            if exposure.added.shape[0] > 0:
                state[0] += exposure.added[k, 0]
                state[1] += exposure.added[k, 1]
            if exposure.lost.shape[0] == 0 or not exposure.lost[k]:
                arrival, heard = classify(heard, k, timeout, plant.dt)
                for i in range(exposure.channels.shape[0]):
                    received[i] = state[exposure.channels[i]]
                now_r, detector, relay = control(
                    source, lifting, detector_params, relay_params, detector, relay,
                    arrival, arrival, False, False, k, received, work,
                )  # fmt: skip
                now_theta = relay.output
            if exposure.schedule.shape[0] > 0:
                now_theta = exposure.schedule[k]
            displaced = exposure.displaced[k] if exposure.displaced.shape[0] > 0 else 0.0
            x_next, y_next, applied = waves.advance(
                plant, exposure.waves, k, x, y, applied, now_theta, displaced
            )
        r[k], theta[k] = now_r, now_theta
        ground_truth[k, 0], ground_truth[k, 1] = x, y
        x, y = x_next, y_next
    if exposure is not None:
        owner[:] = 0.0  # keeps the received state's memory alive until here
    return len(theta)


@njit()
def run_knobs(
    plant: PlantParams,
    plant_knobs: PlantKnobs,
    controller: Controller,
    knobs: Knobs,
    state: DirectionState,
    work: Workspace,
    x: float,
    y: float,
    measured: NDArray[np.float64],
    ground_truth: NDArray[np.float64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> int:
    """Run the loop with several knobs as :func:`run_kernel` does with one; theta is (M, n)."""
    states = borrowed(measured)
    source, lifting, detector_params, relay_params = controller
    lifting, work = cost.borrow(lifting, work)
    detector, applied = cost.initial(), state.theta.copy()
    for k in range(r.shape[0]):
        if not (math.isfinite(x) and math.isfinite(y)):
            return k
        arrival = Arrival.RESTART if k == 0 else Arrival.NEXT
        measured[k, 0], measured[k, 1] = dynamics.measure(plant, k, x, y)
        ground_truth[k, 0], ground_truth[k, 1] = x, y
        r[k], _, settling, detector = cost.answer(
            source, lifting, detector_params, detector, arrival, k, states[k], work
        )
        state, _, _ = directions.answer(
            relay_params, knobs, state, arrival, False, settling, r[k], False
        )
        for i in range(state.theta.size):  # assigning arrays takes seconds to compile
            theta[k, i] = state.theta[i]
        x, y = dynamics.advance_knobs(plant, plant_knobs, k, x, y, applied, state.theta)
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
    exposure: Exposure | None = None,
) -> LoopResult:
    """Run a closed loop offline.

    Parameters
    ----------
    plant, lifter, esc
        The configurations that the three nodes would have.
    model : KoopmanModel or None
        Needed for the lifted cost only.
    steps : int
        Number of control steps.
    exposure : Exposure, optional
        What disturbs the run.

    Raises
    ------
    koop_core.errors.InputError
        If the lifted cost has no model, or the model or the step sizes do not fit together.
    LoopDiverged
        If the plant's state stops being finite.
    """
    check_fit(plant, lifter, esc, model, 2 if exposure is None else exposure.channels.size)
    x, y = initial_state(plant)
    measured, ground_truth = np.empty((steps, 2)), np.empty((steps, 2))
    r, theta = np.empty(steps), np.empty(steps if esc.count == 1 else (steps, esc.count))
    parameters, signals = controller(lifter, esc, model), (measured, ground_truth, r, theta)
    work = cost.workspace(parameters.lifting)
    if esc.count == 1:
        memory = LoopMemory(cost.initial(), esc.initial())
        done = run_kernel(plant.params(), parameters, memory, work, x, y, *signals, exposure)
    else:
        if exposure is not None:
            raise InputError("a run with several knobs cannot be disturbed")
        done = run_knobs(
            plant.params(), plant.knob_params(), parameters, esc.knob_limits(plant.dt),
            esc.initial_directions(), work, x, y, *signals,
        )  # fmt: skip
    if done < steps:
        raise LoopDiverged(f"the plant diverged at t = {done * plant.dt:g} s: use a smaller dt")
    return LoopResult(plant.dt, measured, ground_truth, r, theta)


def check_fit(
    plant: PlantConfig,
    lifter: LifterConfig,
    esc: EscConfig,
    model: KoopmanModel | None,
    channels: int = 2,
) -> None:
    """Raise ValueError unless the three configurations and the model belong together.

    ``channels`` is how many of the plant's two states the lifter is given.
    """
    if plant.dt != lifter.dt:
        raise InputError(f"dt differs: plant {plant.dt}, lifter {lifter.dt} s")
    if plant.count != esc.count:
        raise InputError(f"the plant has {plant.count} knobs, the controller {esc.count}")
    if plant.theta_initial != esc.theta_initial:
        raise InputError(
            f"theta_initial differs: plant {plant.theta_initial}, esc {esc.theta_initial}"
        )
    if model is None:
        if lifter.cost == "lifted":
            raise InputError("the lifted cost needs a model")
        return
    if model.delays.channels != channels:
        raise InputError(
            f"the model is for {model.delays.channels} channels, the plant gives {channels}"
        )
    if model.dt != plant.dt:
        raise InputError(f"the model was trained at dt = {model.dt} s, the loop runs at {plant.dt}")
