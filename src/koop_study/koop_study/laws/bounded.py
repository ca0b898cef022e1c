"""Extremum seeking with bounded update rates.

    u' = sqrt(alpha omega) cos(omega t + k J)

A. Scheinker and M. Krstic: Extremum seeking with bounded update rates, Systems & Control Letters 63
(2014) 25-31. The cost enters the phase only: however wrong it is, the rate stays within
sqrt(alpha omega). On average u' = -(k alpha / 2) dJ/du, and u dithers by sqrt(alpha / omega).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

ALPHA, OMEGA, K = range(3)
POSITION, TIME = range(2)


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names."""
    m[TIME] += dt
    rate = math.sqrt(p[ALPHA] * p[OMEGA]) * math.cos(p[OMEGA] * m[TIME] + p[K] * cost)
    m[POSITION] = min(max(m[POSITION] + dt * rate, 0.0), 1.0)
    return m[POSITION]
