"""Replay on the kernels, without ROS: a million steps in seconds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from koop_lab.replay.plan import Plan
from koop_lab.replay.recording import Recording
from koop_node.stream import Arrival, StreamMonitor
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting
from koopman_lifter.model import load
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState


class Controller(NamedTuple):
    """What lifter and controller remember between two messages.

    Attributes
    ----------
    detector : DetectorState
        Of the lifter.
    relay : RelayState
        Of the controller.
    theta : float
        Its last answer.
    """

    detector: DetectorState
    relay: RelayState
    theta: float


@njit(cache=True)
def replay_kernel(
    source: int,
    lifting: Lifting,
    detector_params: DetectorParams,
    fresh: DetectorState,
    esc: RelayParams,
    largest_change: float,
    state: Controller,
    anew: bool,
    heard: NDArray[np.int8],
    heard_cost: NDArray[np.int8],
    x: NDArray[np.float64],
    hold: NDArray[np.bool_],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> Controller:
    """Answer M states one after the other, as the two nodes do.

    Parameters
    ----------
    source, lifting, detector_params
        Parameters of the lifter.
    fresh : DetectorState
        The detector before its first sample.
    esc, largest_change
        Parameters of the controller.
    state : Controller
        After the previous message.
    anew : bool
        Whether the first cost is of another quantity than the one before.
    heard, heard_cost : ndarray, shape (M,)
        What the lifter's StreamMonitor says about each state, and the controller's about its cost;
        Arrival.LATE for a state that newer ones had overtaken.
    x : ndarray, shape (M, n)
        Measured states; one that is not finite has no cost.
    hold : ndarray, shape (M,)
        Whether the user holds theta.
    r, theta : ndarray, shape (M,)
        Receive the answers; NaN for a state that came too late for one.

    Returns
    -------
    Controller
        After the last message.
    """
    detector, relay_state, last = state.detector, state.relay, state.theta
    z = np.empty(lifting.parent.shape[0])
    for k in range(heard.shape[0]):
        if heard[k] == Arrival.LATE:
            r[k] = theta[k] = np.nan
            continue
        if heard[k] == Arrival.RESTART:
            detector = fresh
        elif heard[k] == Arrival.RESUME:
            detector = cost.resume(detector)
        r[k], _, detector = cost.step(source, lifting, detector_params, detector, x[k], z)
        if np.isnan(r[k]):
            detector = cost.resume(detector)
        from_nothing = anew or heard_cost[k] != Arrival.NEXT
        relay_state, _ = relay.respond(esc, relay_state, r[k], from_nothing, hold[k])
        anew = False
        last = relay.slew(last, relay_state.theta, largest_change)
        theta[k] = last
    return Controller(detector, relay_state, last)


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
    state = Controller(cost.initial(), first.esc.initial(), first.esc.initial().theta)
    states = StreamMonitor("state", first.lifter.state_timeout, first.lifter.dt)
    costs = StreamMonitor("cost", first.esc.cost_timeout, first.esc.dt)
    origin = None
    x: NDArray[np.float64] | None = None
    for stretch in plan.stretches:
        part = slice(stretch.begin, stretch.end)
        lifter, esc = stretch.parameters.lifter, stretch.parameters.esc
        model = load(stretch.parameters.model.path)
        if x is None or x.shape[1] != model.observables.n:
            x = recording.states(model.observables.n)
        if any({"cost", "model"} & set(change.values) for change in stretch.changed):
            state = state._replace(detector=cost.initial())
        anew, origin = origin != (lifter.source, model.model_id), (lifter.source, model.model_id)
        states.timeout, costs.timeout = lifter.state_timeout, esc.cost_timeout
        heard = listen(states, recording.step[part])
        heard_cost = np.full_like(heard, Arrival.LATE)
        heard_cost[heard != Arrival.LATE] = listen(
            costs, recording.step[part][heard != Arrival.LATE]
        )
        state = replay_kernel(
            lifter.source,
            model.lifting(),
            lifter.detector_params(),
            cost.initial(),
            esc.params(),
            esc.largest_change,
            state,
            anew,
            heard,
            heard_cost,
            x[part],
            recording.hold[part],
            r[part],
            theta[part],
        )
    return r, theta


def listen(monitor: StreamMonitor, step: NDArray[np.int64]) -> NDArray[np.int8]:
    """Return what a monitor says about messages."""
    return np.array([monitor.classify(number, 0.0, 0.0) for number in step.tolist()], np.int8)
