"""Newton-like extremum seeking: the rate does not depend on the map's curvature.

    xi      = washout(J),   corner omega_w
    G       = low-pass(2/a xi sin(omega t)),                        corner omega_g
    H       = low-pass(16/a^2 xi (sin^2(omega t) - 1/2)),           corner omega_g
    gamma' = omega_r gamma (1 - gamma H)            gamma -> 1 / H without a division
    centre' = -gain gamma G,   u = centre + a sin(omega t)

W. H. Moase, C. Manzie, M. J. Brear: Newton-like extremum-seeking for the control of thermoacoustic
instability, IEEE Trans. Automatic Control 55 (2010) 2094-2105; the demodulation and the Riccati
filter as in A. Ghaffari, M. Krstic, D. Nesic: Multivariable Newton-based extremum seeking,
Automatica 48 (2012) 1759-1767. On a quadratic map the centre converges with the rate ``gain``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit

A, OMEGA, GAIN, OMEGA_W, OMEGA_G, OMEGA_R = range(6)
CENTRE, SLOW, GRADIENT, HESSIAN, GAMMA, TIME = range(6)
MOST = 1e3  # of gamma; where the map is flat it would grow for ever


@njit()
def step(p: NDArray[np.float64], m: NDArray[np.float64], dt: float, cost: float) -> float:
    """Process one cost; ``p`` and ``m`` in the order of the module's names."""
    if m[TIME] == 0.0:
        m[SLOW] = cost
        m[GAMMA] = 0.1 if m[GAMMA] == 0.0 else m[GAMMA]
    m[TIME] += dt
    dither = math.sin(p[OMEGA] * m[TIME])
    m[SLOW] += -math.expm1(-p[OMEGA_W] * dt) * (cost - m[SLOW])
    xi = cost - m[SLOW]
    weight = -math.expm1(-p[OMEGA_G] * dt)
    a = p[A]
    m[GRADIENT] += weight * (2.0 / a * xi * dither - m[GRADIENT])
    m[HESSIAN] += weight * (16.0 / (a * a) * xi * (dither * dither - 0.5) - m[HESSIAN])
    m[GAMMA] += dt * p[OMEGA_R] * m[GAMMA] * (1.0 - m[GAMMA] * m[HESSIAN])
    m[GAMMA] = min(max(m[GAMMA], 1e-6), MOST)
    m[CENTRE] -= dt * p[GAIN] * m[GAMMA] * m[GRADIENT]
    m[CENTRE] = min(max(m[CENTRE], 0.0), 1.0)
    return m[CENTRE] + a * math.sin(p[OMEGA] * (m[TIME] + dt))
