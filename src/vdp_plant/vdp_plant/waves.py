"""Parts of the plant that depend on time alone, evaluated once for all loops of a study.

Damping, forcing and interference are eight sines a step, half of the time of a loop. A step from
these tables has the bits of :mod:`vdp_plant.dynamics`: the same functions fill them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from vdp_plant import dynamics
from vdp_plant.dynamics import PlantParams

LONGEST = 1 << 20  # steps of a table: 56 MB. Those after it evaluate their own sines


class Waves(NamedTuple):
    """Rows of the first M steps, perhaps of none.

    Attributes
    ----------
    drive : ndarray, shape (M, 6)
        epsilon0(t) [-] and f(t) [1/s^2] at the begin, the middle and the end of a step.
    interference : ndarray, shape (M,)
        i(t) at its begin.
    """

    drive: NDArray[np.float64]
    interference: NDArray[np.float64]


@njit()
def _fill(p: PlantParams, drive: NDArray[np.float64], interference: NDArray[np.float64]) -> None:
    h = p.dt
    half = 0.5 * h
    for k in range(drive.shape[0]):
        t = k * h
        drive[k, 0], drive[k, 1] = dynamics.damping(p, t), dynamics.forcing(p, t)
        drive[k, 2], drive[k, 3] = dynamics.damping(p, t + half), dynamics.forcing(p, t + half)
        drive[k, 4], drive[k, 5] = dynamics.damping(p, t + h), dynamics.forcing(p, t + h)
    for k in range(interference.shape[0]):
        interference[k] = dynamics.interference(p, k)


def drive_of(p: PlantParams, steps: int) -> NDArray[np.float64]:
    """Return the drive of a run."""
    drive = np.empty((min(steps, LONGEST), 6))
    _fill(p, drive, np.empty(0))
    return drive


def interference_of(p: PlantParams, steps: int) -> NDArray[np.float64]:
    """Return the interference of a run."""
    interference = np.empty(min(steps, LONGEST))
    _fill(p, np.empty((0, 6)), interference)
    return interference


def waves_of(p: PlantParams, steps: int) -> Waves:
    """Return both of a run."""
    return Waves(drive_of(p, steps), interference_of(p, steps))


@njit()
def measure(p: PlantParams, waves: Waves, k: int, x: float, y: float) -> tuple[float, float]:
    """Do :func:`vdp_plant.dynamics.measure`."""
    if k >= waves.interference.shape[0]:
        return dynamics.measure(p, k, x, y)
    disturbance = waves.interference[k]
    return x + disturbance, y + disturbance


@njit()
def advance(
    p: PlantParams,
    waves: Waves,
    k: int,
    x: float,
    y: float,
    applied: float,
    theta: float,
    displaced: float,
) -> tuple[float, float, float]:
    """Do :func:`vdp_plant.dynamics.advance`."""
    if k >= waves.drive.shape[0]:
        return dynamics.advance(p, k, x, y, applied, theta, displaced)
    applied = dynamics.actuate(p, applied, theta)
    d = waves.drive
    x, y = dynamics.runge_kutta(
        p, d[k, 0], d[k, 1], d[k, 2], d[k, 3], d[k, 4], d[k, 5], x, y, applied - displaced
    )
    return x, y, applied
