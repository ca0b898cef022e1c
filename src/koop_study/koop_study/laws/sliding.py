"""Sliding-mode extremum seeking with a periodic switching function.

    s = J + rho t,   u' = gain sgn(sin(pi s / beta))

S. Drakunov, U. Ozguner, P. Dix, B. Ashrafi: ABS control using optimum search via sliding modes,
IEEE Trans. Control Systems Technology 3 (1995) 79-85; I. Haskara, U. Ozguner, J. Winkelman:
Extremum control for optimal operating point determination and set point optimization via sliding
modes, ASME J. Dynamic Systems, Measurement and Control 122 (2000) 719-724; Y. Pan, U. Ozguner,
T. Acarman: Stability and performance improvement of extremum seeking control with sliding mode,
Int. J. Control 76 (2003) 968-985. Where \\|dJ/du\\| gain > rho, s stays on one of the surfaces
s = n beta whatever the sign of the slope, and J falls with the rate rho; near the optimum the slope
is too small for that, and u crosses it to and fro.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

GAIN, RHO, BETA = range(3)
POSITION, TIME = range(2)


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names."""
    m[TIME] += dt
    s = cost + p[RHO] * m[TIME]
    rate = p[GAIN] if math.sin(math.pi * s / p[BETA]) >= 0.0 else -p[GAIN]
    m[POSITION] = min(max(m[POSITION] + dt * rate, 0.0), 1.0)
    return m[POSITION]
