"""Which run of a recording a message is of: steps may restart within a bag. Pure.

A message is known by its pass (how many runs began before it, as the nodes' StreamMonitor sees
it) and its step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_core.stream.arrival import NOTHING, Arrival
from koop_loop.kernel import listen

STATE_TYPE = "koop_msgs/msg/MeasuredState"
MAX_STEP = 2**40  # 170 years at 200 Hz; leaves room for the number of the pass in 64 bits


def keys(step: NDArray[np.int64]) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """Return what a StreamMonitor says about each message, and pass and step in one number.

    Raises
    ------
    koop_core.errors.InputError
        If a step is none.
    """
    if step.size and not 0 <= step.min() <= step.max() < MAX_STEP:
        raise InputError("a step is not a count: the recording is damaged")
    kinds = np.empty(step.size, np.int8)
    listen(step, 0.0, 0.0, NOTHING, kinds)
    begins = (kinds == Arrival.RESTART) | (kinds == Arrival.JOIN)
    return kinds, np.cumsum(begins) * MAX_STEP + step
