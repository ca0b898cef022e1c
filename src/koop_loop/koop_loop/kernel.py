"""Parameters and state of lifter and controller, and what messages are to them.

The rules for a gap, a restart, a join, an unusable state and a limit stand in
:func:`koopman_lifter.cost.answer` and :func:`relay_esc.relay.answer`, which the nodes call once a
message, and every loop and replay here, in the order of the nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.stream import arrival
from koop_core.stream.arrival import Heard
from koopman_lifter.cost import DetectorParams, DetectorState, Lifting
from relay_esc.directions import DirectionState
from relay_esc.relay import RelayParams, RelayState

classify = njit()(arrival.classify)
timeout_of = njit()(arrival.timeout_of)


class Controller(NamedTuple):
    """Parameters of lifter and controller."""

    source: int
    """RAW or LIFTED."""
    lifting: Lifting
    """Arrays of the model."""
    detector: DetectorParams
    """Filters of the lifter."""
    relay: RelayParams
    """Law of the controller."""


class LoopMemory(NamedTuple):
    """State of lifter and controller between two messages."""

    detector: DetectorState
    relay: RelayState | DirectionState  # of several knobs


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
