"""The plant's time against the machine's: late ticks, and how old the state behind a theta is.

Pure: no ROS, and time is an argument. Plain Python in the node, and compiled into its stages.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

KEPT = 4096  # states whose sending time is kept: 20 s at 200 Hz


def tick(due: float, period: float, now: float) -> tuple[int, float]:
    """Return how many others a tick has taken the place of, and when the next one is due.

    A timer drops periods that are past; a tick this late has taken the place of several. They are
    never run in a burst: simulated time falls behind instead. All times are steady ones [s].
    """
    late = max(math.floor((now - due) / period), 0)
    return late, due + (late + 1) * period


def age(sent: NDArray[np.float64], last: int, period: float, step: int, now: float) -> float:
    """Return how long ago the state of a step was published [s]; NaN if it was not, here.

    ``sent``, shape (KEPT,), holds when [s] the newest states went out, each at its step modulo
    KEPT; ``last`` is the newest step, ``period`` [s] the shortest time between two. For a state
    that is further back than what is kept it is the least that can be.
    """
    if not 0 <= step <= last:
        return math.nan
    if last - step < KEPT:
        return now - sent[step % KEPT]
    return (last - step) * period
