"""One step of lifter and controller, compiled: the nodes' answers composed, without ROS.

The rules for a gap, a restart, a join, an unusable state and a limit stand in
:func:`koopman_lifter.cost.answer` and :func:`relay_esc.relay.answer`, which the nodes call once a
message. What is here puts them together in the order of the nodes: the offline loop and the
benchmarks call :func:`control`, the study the same two functions with other costs and controllers
in their places, the replay the controller with the barrier of a constraint around it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.stream import arrival
from koop_core.stream.arrival import Heard
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting, Workspace
from relay_esc import relay
from relay_esc.directions import DirectionState
from relay_esc.relay import RelayParams, RelayState

classify = njit()(arrival.classify)
timeout_of = njit()(arrival.timeout_of)


class Controller(NamedTuple):
    """Parameters of lifter and controller.

    Attributes
    ----------
    source : int
        RAW or LIFTED.
    lifting : Lifting
        Arrays of the model.
    detector : DetectorParams
        Filters of the lifter.
    relay : RelayParams
        Law of the controller.
    """

    source: int
    lifting: Lifting
    detector: DetectorParams
    relay: RelayParams


class LoopMemory(NamedTuple):
    """State of lifter and controller between two messages."""

    detector: DetectorState
    relay: RelayState | DirectionState  # of several knobs


@njit(inline="always")
def control(
    source: int,
    lifting: Lifting,
    detector_params: DetectorParams,
    relay_params: RelayParams,
    detector: DetectorState,
    relay_state: RelayState,
    state_arrival: int,
    cost_arrival: int,
    switched: bool,
    hold_asked: bool,
    step: int,
    x: NDArray[np.float64],
    work: Workspace,
) -> tuple[float, DetectorState, RelayState]:
    """Answer one measured state with a control input.

    The parameters stand one by one because tuples of tuples of arrays cost the loop 5 %.

    Parameters
    ----------
    source, lifting, detector_params, relay_params, detector, relay_state
        What a :class:`Controller` and a :class:`LoopMemory` hold.
    state_arrival, cost_arrival : int
        What the state is to the lifter and its cost to the controller: an
        :class:`koop_core.stream.arrival.Arrival` up to JOIN.
    switched, hold_asked : bool
        Whether the cost is of another quantity than the one before, and the user holds theta.
    step : int
        Step index k.
    x : ndarray, shape (channels,)
        Measured state x'_k; NaN where it is unusable.
    work : Workspace
        Buffers of this run.

    Returns
    -------
    r : float
        Cost; NaN for an unusable state and while the detector settles.
    detector, relay_state
        After this state; ``relay_state.output`` is the control input.
    """
    r, _, settling, detector = cost.answer(
        source, lifting, detector_params, detector, state_arrival, step, x, work
    )
    relay_state, _, _ = relay.answer(
        relay_params, relay_state, cost_arrival, switched, settling, r, hold_asked
    )
    return r, detector, relay_state


@njit()
def listen(steps: NDArray[np.int64], dt: float, heard: Heard, arrivals: NDArray[np.int8]) -> Heard:
    """Say of every message what a node's StreamMonitor would say.

    ``steps``, shape (M,), are in the order in which the messages came; ``arrivals``, shape (M,),
    receives an :class:`koop_core.stream.arrival.Arrival` each; ``dt`` [s] is the time between two
    steps, 0 where no silence counts. Returns the stream after.
    """
    timeout = timeout_of(dt)
    for i in range(steps.shape[0]):
        arrivals[i], heard = classify(heard, steps[i], timeout, dt)
    return heard
