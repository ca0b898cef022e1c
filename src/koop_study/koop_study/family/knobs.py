"""A rig of the family with several knobs: what acts in it is how far they are from the optimum.

Its amplitude is that of the random rig at  u = u* + reach |M (v - v*)|  of the positions v of the
knobs, 0 to 1: M couples them (:func:`koop_study.simulation.knobs.coupling`), and the corner of the
range that is farthest away is the upper end of the random rig's own range.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_study.family import oscillator
from koop_study.family.config import FamilyConfig
from koop_study.family.oscillator import RigParams
from koop_study.family.rig import RandomRig, draw
from koop_study.simulation.knobs import coupling
from koop_tune.rig.rig_file import RigFile, state_source
from vdp_plant.dynamics import distance

Array = NDArray[np.float64]
NEAREST = 0.05  # u* of the random rig


@dataclass(frozen=True)
class KnobsRig:
    """A rig with several knobs."""

    rig: RandomRig
    """What its theta leads to."""
    m: Array
    """Shape (n, n): M, times the reach."""
    best: Array
    start: Array
    """Shape (n,): v*, and the knobs before any command."""

    def theta(self, v: Array) -> Array:
        """Return the theta that acts at positions, shape (M, n)."""
        return np.array([acting(self.rig.params, self.m, self.best, row) for row in v])

    def excess(self, v: Array) -> float:
        """Return the amplitude at rest at a position, shape (n,), over the best one."""
        at, best = (
            self.rig.amplitude(float(each)) for each in self.theta(np.array([v, self.best]))
        )
        return at / best

    def starting_at(self, v: Array) -> RandomRig:
        """Return the rig at rest at a position, shape (n,)."""
        return replace(self.rig, theta_initial=float(self.theta(v[None])[0]))

    def file(self, rate: float, time: float) -> RigFile:
        """Return its rig file; ``rate`` is in ranges in the rig's own time, ``time`` in [s]."""
        n, start = self.best.size, tuple(self.start.tolist())
        each: dict[str, Any] = {
            "theta_min": (0.0,) * n, "theta_max": (1.0,) * n, "theta_start": start,
            "theta_safe": start, "theta_rate": (rate / self.rig.time,) * n,
        }  # fmt: skip
        return RigFile(
            state_source(self.rig.channels), f"/knobs:{','.join(f'data[{i}]' for i in range(n))}",
            self.rig.params.dt, objective=self.rig.objective, time=time, **each,
        )  # fmt: skip


@njit()
def acting(p: RigParams, m: Array, best: Array, v: Array) -> float:
    """Return the theta that acts at a position, shape (n,)."""
    return oscillator.theta_at(p, p.best + distance(m, v, best))


def draw_knobs(
    family: FamilyConfig, seed: int, n: int, condition: float, useless: bool
) -> KnobsRig:
    """Draw a rig with n knobs; ``useless``: one of them does nothing."""
    config = replace(family, optimum=(NEAREST, NEAREST), drift=(0.0, 0.0), maximised=0.0)
    rig, rng = draw(config, seed), np.random.default_rng([seed, 9])
    m = coupling(n, condition, rng)
    if useless:
        m[:, rng.integers(n)] = 0.0
    best, start = rng.uniform(0.15, 0.85, n), rng.uniform(0.05, 0.95, n)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=n)))
    far = max(math.hypot(*(m @ (corner - best))) for corner in corners)
    return KnobsRig(rig, m * ((1.0 - NEAREST) / far), best, start)
