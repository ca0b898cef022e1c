"""A relay whose gain is drawn at random for each step: our reading of Salsbury and Yu.

    every ``interval``:   epsilon <- -epsilon if the cost rose,   u <- u - epsilon w step,
    w uniform in [0, 2]

T. I. Salsbury, M. G. Yu: A new simple-to-configure self-perturbing multivariable extremum-seeking
controller, arXiv 2605.20038 (IFAC-PapersOnLine 2025). Only the abstract could be read: stochastic
relay gains identify the gradient; one constant per input for a static map, here ``step``, and one
more for a dynamic one, here ``interval``. How the gains are distributed, and how the dynamic
version treats the cost between two steps (here: its mean over the second half of the interval), are
ours. With one input nothing has to be told apart; what is left is that no cycle locks in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

STEP, INTERVAL, SEED = range(3)
POSITION, SINCE, EPSILON, LAST, TOTAL, COUNT, RANDOM = range(7)
MODULUS, FACTOR = 2147483647.0, 48271.0  # Park and Miller 1988; exact in float64


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names."""
    if m[RANDOM] == 0.0:
        m[RANDOM] = 1.0 + (p[SEED] * 7919.0) % (MODULUS - 2.0)
        m[EPSILON] = 1.0
        m[LAST] = np.inf
    m[SINCE] += dt
    if m[SINCE] > 0.5 * p[INTERVAL]:
        m[TOTAL] += cost
        m[COUNT] += 1.0
    if m[SINCE] >= p[INTERVAL] and m[COUNT] > 0.0:
        mean = m[TOTAL] / m[COUNT]
        if mean > m[LAST]:
            m[EPSILON] = -m[EPSILON]
        m[LAST], m[SINCE], m[TOTAL], m[COUNT] = mean, 0.0, 0.0, 0.0
        m[RANDOM] = (FACTOR * m[RANDOM]) % MODULUS
        m[POSITION] -= m[EPSILON] * p[STEP] * 2.0 * m[RANDOM] / MODULUS
        m[POSITION] = min(max(m[POSITION], 0.0), 1.0)
    return m[POSITION]
