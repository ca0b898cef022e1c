"""Replay on the kernels, without ROS: a million steps in seconds."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from koop_lab.replay.plan import Plan
from koop_lab.replay.recording import Recording
from koop_node.stream import WINDOW
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting
from koopman_lifter.model import load
from relay_esc import relay
from relay_esc.relay import RelayParams, RelayState


@njit(cache=True)
def replay_kernel(
    source: int,
    lifting: Lifting,
    detector: DetectorParams,
    detector_state: DetectorState,
    fresh: DetectorState,
    esc: RelayParams,
    relay_state: RelayState,
    anew: bool,
    previous: int,
    step: NDArray[np.int64],
    x: NDArray[np.float64],
    hold: NDArray[np.bool_],
    silences: tuple[float, float],
    r: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> tuple[DetectorState, RelayState]:
    """Answer M states one after the other, as the two nodes do.

    Parameters
    ----------
    source, lifting, detector, esc
        Parameters of lifter and controller.
    detector_state, relay_state
        States after the previous message.
    fresh : DetectorState
        The detector before its first sample.
    anew : bool
        Whether the first cost is of another quantity than the one before.
    previous : int
        Step of the previous message; -1 for none.
    step : ndarray, shape (M,)
        Step of each state; one that goes back begins anew.
    x : ndarray, shape (M, n)
        Measured states; one that is not finite has no cost.
    hold : ndarray, shape (M,)
        Whether the user holds theta.
    silences : tuple of float
        Steps between two messages beyond which lifter and controller find the input stale.
    r, theta : ndarray, shape (M,)
        Receive the answers.

    Returns
    -------
    detector_state, relay_state
        States after the last message.
    """
    z = np.empty(lifting.parent.shape[0])
    for k in range(step.shape[0]):
        if previous > step[k] >= max(previous - WINDOW, 1):  # overtaken: the nodes don't answer
            r[k], theta[k] = np.nan, relay_state.theta
            continue
        back, gap = step[k] < previous, step[k] - previous if previous >= 0 else 0
        previous = step[k]
        if back:
            detector_state = fresh
        elif gap > silences[0]:
            detector_state = cost.resume(detector_state)
        r[k], _, detector_state = cost.step(source, lifting, detector, detector_state, x[k], z)
        if np.isnan(r[k]):
            detector_state = cost.resume(detector_state)
        from_nothing = anew or back or gap > silences[1]
        relay_state, _ = relay.respond(esc, relay_state, r[k], from_nothing, hold[k])
        anew = False
        theta[k] = relay_state.theta
    return detector_state, relay_state


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
    detector_state = cost.initial()
    relay_state = plan.stretches[0].parameters.esc.initial()
    origin = None
    x: NDArray[np.float64] | None = None
    for stretch in plan.stretches:
        part = slice(stretch.begin, stretch.end)
        lifter, esc = stretch.parameters.lifter, stretch.parameters.esc
        model = load(stretch.parameters.model.path)
        if x is None or x.shape[1] != model.observables.n:
            x = recording.states(model.observables.n)
        if any({"cost", "model"} & set(change.values) for change in stretch.changed):
            detector_state = cost.initial()
        anew, origin = origin != (lifter.source, model.model_id), (lifter.source, model.model_id)
        detector_state, relay_state = replay_kernel(
            lifter.source,
            model.lifting(),
            lifter.detector_params(),
            detector_state,
            cost.initial(),
            esc.params(),
            relay_state,
            anew,
            int(recording.step[stretch.begin - 1]) if stretch.begin else -1,
            recording.step[part],
            x[part],
            recording.hold[part],
            (_silence(lifter.state_timeout, lifter.dt), _silence(esc.cost_timeout, esc.dt)),
            r[part],
            theta[part],
        )
    return r, theta


def _silence(timeout: float, dt: float) -> float:
    """Return a timeout [s] in steps; infinite if it is off."""
    return timeout / dt if timeout > 0.0 else np.inf
