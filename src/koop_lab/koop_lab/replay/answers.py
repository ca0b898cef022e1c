"""Replay on the kernels that the nodes call, without ROS: a million steps in seconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.kernels import njit
from koop_core.stream.arrival import NOTHING, Arrival
from koop_lab.replay.plan import ReplayPlan
from koop_lab.replay.recording import Recording
from koop_loop.kernel import Controller, LoopMemory, listen
from koop_loop.loop import controller
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from koopman_lifter.cost import Workspace
from koopman_lifter.model import KoopmanModel
from relay_esc import barrier, directions
from relay_esc.barrier import BarrierParams, BarrierState
from relay_esc.config import EscConfig
from relay_esc.directions import Knobs


@njit()
def replay_kernel(
    p: Controller,
    bound: BarrierParams | None,
    knobs: Knobs | None,
    memory: LoopMemory,
    held: BarrierState,
    work: Workspace,
    switched: bool,
    step: NDArray[np.int64],
    state_arrivals: NDArray[np.int8],
    cost_arrivals: NDArray[np.int8],
    x: NDArray[np.float64],
    hold: NDArray[np.bool_],
    margin: NDArray[np.float64],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> tuple[LoopMemory, BarrierState]:
    """Answer M states one after the other, as the two nodes do.

    Parameters
    ----------
    p, bound, knobs : Controller, BarrierParams, Knobs
        Parameters; ``bound`` of one knob, else None, which the compiler leaves out; ``knobs`` of
        several, else None.
    memory, held : LoopMemory, BarrierState
        After the previous message; the memory of several knobs has their DirectionState.
    work : Workspace
        Buffers of this run.
    switched : bool
        Whether the first cost is of another quantity than the one before.
    step : ndarray of int64, shape (M,)
        Step of each state.
    state_arrivals, cost_arrivals : ndarray, shape (M,)
        What each state is to the lifter and its cost to the controller; LATE for a state that newer
        ones had overtaken, which has no answer.
    x : ndarray, shape (M, n)
        Measured states; one that is not finite has no cost.
    hold : ndarray, shape (M,)
        Whether the user holds theta.
    margin : ndarray, shape (M,)
        Of the constraint; NaN where it is not known.
    r, theta : ndarray, shape (M,)
        Receive the answers; NaN where there is none.

    Returns
    -------
    memory, held
        After the last message.
    """
    source, lifting, detector_params, relay_params = p
    lifting, work = borrowed(lifting), borrowed(work)
    states = borrowed(x)
    detector, relay = memory
    for k in range(r.shape[0]):
        if state_arrivals[k] == Arrival.LATE:
            r[k] = np.nan
            theta[k] = np.nan
            continue
        r[k], _, settling, detector = cost.answer(
            source, lifting, detector_params, detector, state_arrivals[k], step[k], states[k], work
        )
        if bound is not None:
            relay, held, _, _ = barrier.answer(
                relay_params, bound, relay, held, cost_arrivals[k], switched, settling, r[k],
                hold[k], margin[k],
            )  # fmt: skip
            theta[k] = relay.output
        if knobs is not None:
            relay, _, _ = directions.answer(
                relay_params, knobs, relay, cost_arrivals[k], switched, settling, r[k], hold[k]
            )
            theta[k] = relay.theta
        switched = False
    return LoopMemory(detector, relay), held


class ReplayedLoop:
    """Lifter and controller on their kernels, from one segment of states to the next."""

    def __init__(self, esc: EscConfig) -> None:
        begin = esc.initial() if esc.count == 1 else esc.initial_directions()
        self._memory, self._held = LoopMemory(cost.initial(), begin), barrier.UNKNOWN
        self._work: Workspace | None = None
        self._states = self._costs = NOTHING
        self._origin: tuple[int, str] | None = None

    def restart_detector(self, lifter: LifterConfig) -> None:
        """Forget the energies before: a cost or a model was set."""
        self._memory = self._memory._replace(detector=cost.joining(lifter.detector_params()))
        self._work = None

    def answer(
        self,
        lifter: LifterConfig,
        esc: EscConfig,
        model: KoopmanModel | None,
        step: NDArray[np.int64],
        x: NDArray[np.float64],
        hold: NDArray[np.bool_],
        margin: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return r and theta, shape (M,), that answer states with the same parameters.

        The states are those of :func:`replay_kernel`.
        """
        made = controller(lifter, esc, model)
        if self._work is None:
            self._work = cost.workspace(made.lifting)
        origin = (lifter.source, model.model_id if model is not None else "")
        switched, self._origin = origin != self._origin, origin
        states = np.empty(step.size, np.int8)
        self._states = listen(step, lifter.dt, self._states, states)
        answered = states != Arrival.LATE
        arrivals = np.empty(np.count_nonzero(answered), np.int8)
        self._costs = listen(step[answered], lifter.dt, self._costs, arrivals)
        costs = np.full_like(states, Arrival.LATE)
        costs[answered] = arrivals
        n = esc.count
        r, theta = np.empty(step.size), np.empty(step.size if n == 1 else (step.size, n))
        bound = esc.barrier(lifter.dt) if n == 1 else None
        knobs = esc.knob_limits(lifter.dt) if n > 1 else None
        self._memory, self._held = replay_kernel(
            made, bound, knobs, self._memory, self._held, self._work, switched,
            step, states, costs, x, hold, margin, r, theta,
        )  # fmt: skip
        return r, theta


def replay(
    recording: Recording, plan: ReplayPlan
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return r and theta, shape (M,), that lifter and controller answer to a recording."""
    loop = ReplayedLoop(plan.segments[0].parameters.esc)
    answers = []
    x: NDArray[np.float64] | None = None
    for segment in plan.segments:
        part, parameters = slice(segment.begin, segment.end), segment.parameters
        lifter, model = parameters.lifter, parameters.load_model()
        n = model.delays.channels if model is not None and lifter.cost == "lifted" else 0
        if x is None or n not in (0, x.shape[1]):
            x = recording.states(n)
        if any({"cost", "model"} & set(change.values) for change in segment.changed):
            loop.restart_detector(lifter)
        answers.append(
            loop.answer(
                lifter, parameters.esc, model,
                recording.step[part], x[part], recording.hold[part], recording.margin[part],
            )
        )  # fmt: skip
    r, theta = zip(*answers, strict=True)
    return np.concatenate(r), np.concatenate(theta)
