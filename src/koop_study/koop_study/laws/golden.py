"""Golden-section search on settled costs: tune once, then rest.

u rests for ``hold`` at each point; the cost there is the mean over the second half. The section
shrinks by 0.618 a point until it is as wide as ``resolution``; u then rests at its middle.
J. Kiefer: Sequential minimax search for a maximum, Proc. American Mathematical Society 4 (1953)
502-506. It needs a map with one valley and costs without noise, and never looks again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

HOLD, RESOLUTION = range(2)
LOW, HIGH, LEFT, RIGHT, COST_LEFT, COST_RIGHT, STAGE, SINCE, TOTAL, COUNT = range(10)
RATIO = (math.sqrt(5.0) - 1.0) / 2.0
FIRST, SECOND, NEW_LEFT, NEW_RIGHT, REST = 0.0, 1.0, 2.0, 3.0, 4.0  # what is being looked at


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names."""
    if m[HIGH] == 0.0:
        m[LOW], m[HIGH], m[LEFT], m[RIGHT] = 0.0, 1.0, 1.0 - RATIO, RATIO
    if m[STAGE] == REST:
        return 0.5 * (m[LOW] + m[HIGH])
    m[SINCE] += dt
    if m[SINCE] > 0.5 * p[HOLD]:
        m[TOTAL] += cost
        m[COUNT] += 1.0
    if m[SINCE] >= p[HOLD] and m[COUNT] > 0.0:
        mean = m[TOTAL] / m[COUNT]
        m[SINCE], m[TOTAL], m[COUNT] = 0.0, 0.0, 0.0
        if m[STAGE] == FIRST:
            m[COST_LEFT], m[STAGE] = mean, SECOND
        else:
            if m[STAGE] == NEW_LEFT:
                m[COST_LEFT] = mean
            else:
                m[COST_RIGHT] = mean
            if m[COST_LEFT] < m[COST_RIGHT]:
                m[HIGH], m[RIGHT], m[COST_RIGHT] = m[RIGHT], m[LEFT], m[COST_LEFT]
                m[LEFT], m[STAGE] = m[HIGH] - RATIO * (m[HIGH] - m[LOW]), NEW_LEFT
            else:
                m[LOW], m[LEFT], m[COST_LEFT] = m[LEFT], m[RIGHT], m[COST_RIGHT]
                m[RIGHT], m[STAGE] = m[LOW] + RATIO * (m[HIGH] - m[LOW]), NEW_RIGHT
            if m[HIGH] - m[LOW] <= p[RESOLUTION]:
                m[STAGE] = REST
                return 0.5 * (m[LOW] + m[HIGH])
    return m[LEFT] if m[STAGE] == FIRST or m[STAGE] == NEW_LEFT else m[RIGHT]
