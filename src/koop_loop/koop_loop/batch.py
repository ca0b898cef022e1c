"""Many closed loops offline, side by side: the bits of one after the other, three times as fast.

What depends on time alone, the plant's damping and forcing and where the phases are the same the
interference, is evaluated once for all loops of a batch. Loops take a step in groups: arithmetic
without decisions (measurement, lifting, Runge-Kutta) over arrays that the compiler turns into
vector instructions, each loop with the operations of the single one in their order; detector and
relay are the nodes' own functions, loop by loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import borrowed, njit
from koop_core.stream.arrival import Arrival
from koop_loop.kernel import Controller
from koop_loop.loop import check_fit, controller, initial_state, simulate
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.cost import DetectorState, Lifting
from koopman_lifter.model import KoopmanModel
from relay_esc import relay
from relay_esc.config import EscConfig
from relay_esc.relay import RelayState
from relay_esc.swing import Swing
from vdp_plant import dynamics, waves
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantParams

GROUP = 32  # loops that take a step together; with 8 the vector instructions hardly pay
BLOCK = 512  # steps whose waves are kept at a time: they stay in the cache
STATES = 2  # of the plant, both measured
NUMBERS, COUNTS = 21, 8  # of a detector's and a relay's state


@dataclass(frozen=True)
class BatchResult:
    """Signals of several loops, a row each.

    Attributes
    ----------
    dt : float
        Step [s]; step k is at t = k dt.
    r, theta : ndarray, shape (N, M)
        Cost and control input.
    """

    dt: float
    r: NDArray[np.float64]
    theta: NDArray[np.float64]

    @property
    def t(self) -> NDArray[np.float64]:
        """Time [s], shape (M,)."""
        return np.asarray(np.arange(self.theta.shape[1]) * self.dt, dtype=np.float64)


class Given(NamedTuple):
    """What is given to the N loops of a batch, or not: then an array has length 0.

    Attributes
    ----------
    projectors : ndarray, shape (rows, p, N)
        W of the models, see :class:`koopman_lifter.cost.Lifting`.
    interference : ndarray, shape (N, M) or (0, 0)
        i(t_k), unless it is the same for all.
    added : ndarray, shape (N, M, 2) or without any number
        Added to the measured state.
    displaced : ndarray, shape (M,) or (0,)
        How far the optimum is from the plant's theta*, for all of them.
    drive : ndarray, shape (M, 6) or (0, 6)
        See :class:`vdp_plant.waves.Waves`, for all of them; else it is evaluated.
    """

    projectors: NDArray[np.float64]
    interference: NDArray[np.float64]
    added: NDArray[np.float64]
    displaced: NDArray[np.float64]
    drive: NDArray[np.float64]


ALL_THE_SAME = np.empty((0, 0))
NOTHING_ADDED = np.empty((0, 0, 0))
NOT_DISPLACED = np.empty(0)
EVALUATED = np.empty((0, 6))


@njit()
def remember(
    m: NDArray[np.float64],
    n: NDArray[np.int64],
    detector: DetectorState,
    state: RelayState,
    adaptive: bool,
) -> None:
    """Write what a loop remembers into ``m``, shape (NUMBERS,), and ``n``, shape (COUNTS,)."""
    m[0], m[1], m[2] = detector.y_previous, detector.y_hp, detector.y_lp
    m[3], m[4], m[5] = state.u, state.cost_rise_filtered, state.x_previous
    m[6], m[7] = state.given, state.output
    n[0], n[1] = detector.primed, detector.settling
    n[2], n[3], n[4] = state.epsilon, state.since_flip, state.primed
    if adaptive:  # the relay never touches its swing
        s = state.swing
        m[8], m[9], m[10], m[11] = s.factor, s.stretch, s.level, s.begin
        m[12], m[13], m[14], m[15] = s.lowest, s.lowest_before, s.reference, s.noise
        m[16], m[17], m[18] = s.dip, s.turned, s.centre
        m[19], m[20] = s.cost, s.rise
        n[5], n[6], n[7] = s.legs, s.short, s.centred


@njit()
def detector_of(m: NDArray[np.float64], n: NDArray[np.int64]) -> DetectorState:
    """Return what :func:`remember` wrote of the detector."""
    return DetectorState(m[0], m[1], m[2], n[0] != 0, n[1])


@njit()
def relay_of(m: NDArray[np.float64], n: NDArray[np.int64]) -> RelayState:
    """Return what :func:`remember` wrote of the relay."""
    swing = Swing(
        m[8], m[9], m[10], m[11], m[12], m[13], m[14], m[15], m[16], n[5], n[6], m[17], m[18], n[7],
        m[19], m[20],
    )  # fmt: skip
    return RelayState(m[3], n[2], m[4], m[5], n[3], n[4] != 0, m[6], m[7], swing)


@njit()
def energies(
    source: int,
    lifting: Lifting,
    projectors: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    c: NDArray[np.float64],
    y_out: NDArray[np.float64],
) -> None:
    """Fill ``y_out`` with the energies of the measured states x, y, shape (n,) each.

    ``z``, shape (p, n), and ``c``, shape (n,), are scratch; see :func:`koopman_lifter.cost.energy`.
    """
    n = x.shape[0]
    if source != cost.LIFTED:
        for i in range(n):
            y_out[i] = math.sqrt((x[i] * x[i] + y[i] * y[i]) / 2)
        return
    for i in range(n):
        z[0, i] = 1.0
        y_out[i] = 0.0
    for j in range(1, z.shape[0]):
        parent = lifting.parent[j]
        if lifting.factor[j] == 0:
            for i in range(n):
                z[j, i] = z[parent, i] * x[i]
        else:
            for i in range(n):
                z[j, i] = z[parent, i] * y[i]
    for row in range(projectors.shape[0]):
        for i in range(n):
            c[i] = 0.0
        for j in range(z.shape[0]):
            weights, observable = projectors[row, j], z[j]
            for i in range(n):
                c[i] += weights[i] * observable[i]
        for i in range(n):
            y_out[i] += c[i] * c[i]


@njit()
def run_group(
    p: PlantParams,
    controller: Controller,
    given: Given,
    first: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    applied: NDArray[np.float64],
    m: NDArray[np.float64],
    n: NDArray[np.int64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> None:
    """Advance a group by the steps of ``given.drive``, as ``koop_loop.loop.run_kernel`` one loop.

    The interference is there, too, shape (steps, loops).
    """
    source, lifting, detector_params, relay_params = controller
    loops = x.shape[0]
    z, work = np.empty((lifting.parent.shape[0], loops)), np.empty((5, loops))
    m, n = borrowed(m), borrowed(n)
    c, y_out, measured_x, measured_y, output = work[0], work[1], work[2], work[3], work[4]
    for step in range(given.drive.shape[0]):
        k = first + step
        interference, d = given.interference[step], given.drive[step]
        for i in range(loops):
            measured_x[i] = x[i] + interference[i]
            measured_y[i] = y[i] + interference[i]
        if given.added.size > 0:
            for i in range(loops):
                measured_x[i] += given.added[i, k, 0]
                measured_y[i] += given.added[i, k, 1]
        energies(source, lifting, given.projectors, measured_x, measured_y, z, c, y_out)
        arrival = Arrival.RESTART if k == 0 else Arrival.NEXT
        for i in range(loops):
            r[i, k], detector = cost.follow(
                detector_params, detector_of(m[i], n[i]), arrival, y_out[i]
            )
            state, _, _ = relay.answer(
                relay_params, relay_of(m[i], n[i]), arrival, False, detector.settling > 0,
                r[i, k], False,
            )  # fmt: skip
            remember(m[i], n[i], detector, state, relay_params.adaptive)
            theta[i, k] = output[i] = state.output
        displaced = given.displaced[k] if given.displaced.shape[0] > 0 else 0.0
        for i in range(loops):
            applied[i] = dynamics.actuate(p, applied[i], output[i])
        eps0, force0, eps1, force1, eps2, force2 = d[0], d[1], d[2], d[3], d[4], d[5]
        for i in range(loops):
            x[i], y[i] = dynamics.runge_kutta(
                p, eps0, force0, eps1, force1, eps2, force2, x[i], y[i], applied[i] - displaced
            )


@njit()
def run_kernel(
    p: PlantParams,
    controller: Controller,
    given: Given,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    applied: NDArray[np.float64],
    m: NDArray[np.float64],
    n: NDArray[np.int64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> None:
    """Run N loops; ``x``, ``y``, ``applied``, shape (N,), ``m`` and ``n`` are left as at the end.

    ``r`` and ``theta``, shape (N, M), are filled. A state that is not finite stays so. Projectors
    are those of ``given``, not the controller's.
    """
    loops, steps = theta.shape
    drives, same = np.empty((BLOCK, 6)), np.empty(BLOCK)
    for first in range(0, steps, BLOCK):
        count = min(BLOCK, steps - first)
        if given.drive.shape[0] == 0:
            drive = drives[:count]
            waves.fill_drive(p, first, drive)
        else:
            drive = given.drive[first : first + count]
        if given.interference.shape[0] == 0:
            waves.fill_interference(p, first, same[:count])
        for a in range(0, loops, GROUP):
            b = min(a + GROUP, loops)
            interference = np.empty((count, b - a))
            for i in range(b - a):
                for k in range(count):
                    if given.interference.shape[0] == 0:
                        interference[k, i] = same[k]
                    else:
                        interference[k, i] = given.interference[a + i, first + k]
            group = Given(
                given.projectors[:, :, a:b].copy(), interference, given.added[a:b], given.displaced,
                drive,
            )  # fmt: skip
            run_group(
                p, controller, group, first, x[a:b], y[a:b], applied[a:b], m[a:b], n[a:b],
                r[a:b], theta[a:b],
            )  # fmt: skip


def simulate_batch(
    plants: Sequence[PlantConfig],
    lifter: LifterConfig,
    esc: EscConfig,
    model: KoopmanModel | None,
    steps: int,
) -> BatchResult:
    """Run closed loops offline, to the last bit what ``simulate`` gives of each.

    Parameters
    ----------
    plants : sequence of PlantConfig
        One a loop; they may differ in seed and initial state only.
    lifter, esc, model, steps
        See :func:`koop_loop.loop.simulate`.

    Raises
    ------
    ValueError
        If the plants differ in more, or what ``simulate`` raises.
    koop_loop.loop.LoopDiverged
        If a plant's state stops being finite.
    """
    p = plants[0].params()
    if any(
        plant.params() != p or plant.theta_initial != plants[0].theta_initial for plant in plants
    ):
        raise ValueError("the plants of a batch may differ in seed and initial state only")
    check_fit(plants[0], lifter, esc, model)
    delayed = model is not None and model.delays.n != STATES
    if p.integrator == dynamics.EULER or delayed:  # neither is worth arrays of its own
        alone = [simulate(plant, lifter, esc, model, steps) for plant in plants]
        r, theta = np.array([one.r for one in alone]), np.array([one.theta for one in alone])
        return BatchResult(p.dt, r, theta)
    r, theta, finite = run_batch(plants, lifter, esc, [model] * len(plants), steps)
    for i in np.flatnonzero(~finite):
        simulate(plants[i], lifter, esc, model, steps)  # says when
    return BatchResult(p.dt, r, theta)


def run_batch(
    plants: Sequence[PlantConfig],
    lifter: LifterConfig,
    esc: EscConfig,
    models: Sequence[KoopmanModel | None],
    steps: int,
    interference: NDArray[np.float64] = ALL_THE_SAME,
    added: NDArray[np.float64] = NOTHING_ADDED,
    displaced: NDArray[np.float64] = NOT_DISPLACED,
    drive: NDArray[np.float64] = EVALUATED,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Run closed loops of the Runge-Kutta plant, without delays, that ``check_fit`` lets through.

    Parameters
    ----------
    plants, models : sequence
        One a loop. Plants may differ in seed and initial state and, where ``interference`` is
        given, in its phases; models in their numbers, not in how many these are.
    lifter, esc, steps
        See :func:`koop_loop.loop.simulate`.
    interference, added, displaced, drive
        See :class:`Given`.

    Returns
    -------
    r, theta : ndarray, shape (N, M)
        Cost and control input.
    finite : ndarray of bool, shape (N,)
        Whether the plant's state was, to the end.
    """
    parameters = controller(lifter, esc, models[0])
    projectors = [
        cost.no_lifting().projector if model is None else model.projector for model in models
    ]
    given = Given(np.stack(projectors, axis=-1), interference, added, displaced, drive)
    x, y = np.ascontiguousarray(np.array([initial_state(plant) for plant in plants]).T)
    r, theta = np.empty((len(plants), steps)), np.empty((len(plants), steps))
    m, n = memory(esc, len(plants))
    applied = np.full(len(plants), esc.theta_initial)
    run_kernel(plants[0].params(), parameters, given, x, y, applied, m, n, r, theta)
    return r, theta, np.isfinite(x) & np.isfinite(y)


def memory(esc: EscConfig, loops: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return what loops remember before their first step."""
    m, n = np.empty((loops, NUMBERS)), np.empty((loops, COUNTS), np.int64)
    for i in range(loops):
        remember(m[i], n[i], cost.initial(), esc.initial(), True)
    return m, n
