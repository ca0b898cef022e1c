"""Replay on the kernels, without ROS: a million steps in seconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import borrowed, njit
from koop_core.stream.arrival import NOTHING, Arrival
from koop_lab.replay.plan import Plan
from koop_lab.replay.recording import Recording
from koop_loop.kernel import Controller, Memory, control, listen
from koop_loop.loop import controller
from koopman_lifter import cost
from koopman_lifter.cost import Workspace


@njit()
def replay_kernel(
    p: Controller,
    memory: Memory,
    work: Workspace,
    switched: bool,
    step: NDArray[np.int64],
    state_arrivals: NDArray[np.int8],
    cost_arrivals: NDArray[np.int8],
    x: NDArray[np.float64],
    hold: NDArray[np.bool_],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> Memory:
    """Answer M states one after the other, as the two nodes do.

    Parameters
    ----------
    p : Controller
        Parameters.
    memory : Memory
        After the previous message.
    work : Workspace
        Of this run.
    switched : bool
        Whether the first cost is of another quantity than the one before.
    step : ndarray of int64, shape (M,)
        Step of each state.
    state_arrivals, cost_arrivals : ndarray, shape (M,)
        What each state is to the lifter and its cost to the controller; LATE for a state that newer
        ones had overtaken, which has no answer, and for a cost that the controller did not hear.
    x : ndarray, shape (M, n)
        Measured states; one that is not finite has no cost.
    hold : ndarray, shape (M,)
        Whether the user holds theta.
    r, theta : ndarray, shape (M,)
        Receive the answers; NaN where there is none.

    Returns
    -------
    Memory
        After the last message.
    """
    source, lifting, detector_params, relay_params = p
    lifting, work = cost.borrow(lifting, work)
    states = borrowed(x)
    detector, relay = memory
    for k in range(r.shape[0]):
        if state_arrivals[k] == Arrival.LATE:
            r[k] = theta[k] = np.nan
            continue
        if cost_arrivals[k] == Arrival.LATE:  # the controller did not hear this cost
            r[k], _, _, detector = cost.answer(
                source, lifting, detector_params, detector, state_arrivals[k], step[k], states[k],
                work,
            )  # fmt: skip
            theta[k] = np.nan
            continue
        r[k], detector, relay = control(
            source, lifting, detector_params, relay_params, detector, relay,
            state_arrivals[k], cost_arrivals[k], switched, hold[k], step[k], states[k],
            work,
        )  # fmt: skip
        theta[k] = relay.output
        switched = False
    return Memory(detector, relay)


def replay_offline(
    recording: Recording, plan: Plan
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Replay a recording on the kernels.

    Returns
    -------
    r, theta : ndarray, shape (M,)
        What lifter and controller answer.
    """
    r, theta = np.empty(recording.step.size), np.empty(recording.step.size)
    first = plan.stretches[0].parameters
    memory = Memory(cost.initial(), first.esc.initial())
    states = costs = NOTHING
    origin = None
    x: NDArray[np.float64] | None = None
    work: Workspace | None = None
    for stretch in plan.stretches:
        part = slice(stretch.begin, stretch.end)
        lifter, esc = stretch.parameters.lifter, stretch.parameters.esc
        model = stretch.parameters.load_model()
        if lifter.cost == "lifted" and model is not None:
            if x is None or x.shape[1] != model.delays.channels:
                x = recording.states(model.delays.channels)
        elif x is None:
            x = recording.states()
        if any({"cost", "model"} & set(change.values) for change in stretch.changed):
            memory = memory._replace(detector=cost.joining(lifter.detector_params()))
            work = None
        made = controller(lifter, esc, model)
        if work is None:
            work = cost.workspace(made.lifting)
        now = (lifter.source, model.model_id if model is not None else "")
        switched, origin = origin != now, now
        step = recording.step[part]
        state_arrivals = np.empty(step.size, np.int8)
        states = listen(step, lifter.state_timeout, lifter.dt, states, state_arrivals)
        answered = state_arrivals != Arrival.LATE
        cost_arrivals = np.full_like(state_arrivals, Arrival.LATE)
        heard = answered & ~plan.unheard[part]
        found = np.empty(np.count_nonzero(heard), np.int8)
        costs = listen(step[heard], esc.cost_timeout, esc.dt, costs, found)
        cost_arrivals[heard] = found
        memory = replay_kernel(
            made,
            memory,
            work,
            switched,
            step,
            state_arrivals,
            cost_arrivals,
            x[part],
            recording.hold[part],
            r[part],
            theta[part],
        )
    return r, theta
