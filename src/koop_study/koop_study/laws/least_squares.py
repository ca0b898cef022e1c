"""Extremum seeking on a gradient by recursive least squares with forgetting.

    (g, c)  = argmin sum over the past of exp(-forgetting (t - s)) (J(s) - g u(s) - c)^2
    centre' = -gain g,   u = centre + a sin(omega t)

After M. Guay and D. Dochain: A time-varying extremum-seeking control approach, Automatica 51 (2015)
356-363, where the gradient is a time-varying parameter that is estimated beside the unknown drift
of the cost; the estimator here is the plain exponentially weighted fit of a line, as in
B. G. B. Hunnekens et al., A dither-free extremum-seeking control approach using 1st-order
least-squares fits for gradient estimation, IEEE CDC 2014. A demodulated gradient is right on
average over a period of the dither, this one as soon as u has moved.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

A, OMEGA, GAIN, FORGETTING = range(4)
CENTRE, TIME, U, N, S_U, S_UU, S_J, S_UJ = range(8)


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names.

    ``m[U]`` is the position that the cost answers, filled in by the caller.
    """
    fade = math.exp(-p[FORGETTING] * dt)
    # relative to the centre and to this cost: sums of large numbers would lose the difference
    u = m[U] - 0.5
    m[N] = fade * m[N] + 1.0
    m[S_U] = fade * m[S_U] + u
    m[S_UU] = fade * m[S_UU] + u * u
    m[S_J] = fade * m[S_J] + cost
    m[S_UJ] = fade * m[S_UJ] + u * cost
    spread = m[S_UU] * m[N] - m[S_U] * m[S_U]
    m[TIME] += dt
    # until u has moved over a part of the dither there is no gradient to tell
    if spread > 0.02 * (p[A] * m[N]) ** 2:
        gradient = (m[S_UJ] * m[N] - m[S_U] * m[S_J]) / spread
        m[CENTRE] -= dt * p[GAIN] * gradient
        m[CENTRE] = min(max(m[CENTRE], 0.0), 1.0)
    return m[CENTRE] + p[A] * math.sin(p[OMEGA] * (m[TIME] + dt))
