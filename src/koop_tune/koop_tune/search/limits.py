"""Limits of the controller's theta: where the static map is good, with some room."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from koop_tune.excitation.static_map import GRID, Cliff, StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.settings import TUNING, TuningSettings


class ThetaLimits(NamedTuple):
    """Limits of the controller's theta, and why each is narrower than the rig's.

    Attributes
    ----------
    low, high : float
        Least and largest theta.
    why_low, why_high : str
        Reasons in words; empty where it is the rig's.
    """

    low: float
    high: float
    why_low: str = ""
    why_high: str = ""

    @property
    def why(self) -> str:
        """Both, in words."""
        return "; ".join(why for why in (self.why_low, self.why_high) if why)


def limit_theta(
    amplitude: StaticMap, reference: StaticMap, rig: RigFile, settings: TuningSettings = TUNING
) -> ThetaLimits:
    """Return limits of the controller's theta: where the map is good, and some room.

    What is far from any good value was seen once and need not be seen again: a swing that is wide
    while the optimum is sought, or a loop that noise leads astray, ends at a limit where the rig
    still oscillates little. Beyond the outermost value that may be good theta has some room, for an
    optimum that moves.

    A cliff wants more care. A loop goes a little beyond the optimum again and again; beyond a cliff
    the cost is so large that the filters forget it only slowly, and while they do theta moves on,
    whatever it does. So there theta stays a margin inside the last good value.

    Parameters
    ----------
    amplitude, reference : StaticMap
        The oscillation's; what shows it most clearly, which may be the same.
    rig : RigFile
        Its limits.
    settings : TuningSettings
        Margin and room.
    """
    scale, limits, why = rig.scale, [rig.theta_min, rig.theta_max], ["", ""]
    for end, side in ((0, -1), (1, 1)):
        cliff = known_cliff(amplitude, side, settings.cliff_width)
        if cliff is not None:
            inner, outer = (float(amplitude.u[i]) for i in (cliff.inner, cliff.outer))
            limits[end] = float(f"{scale.theta_at(inner - side * settings.margin):.3g}")
            verb = "rises" if amplitude.sense > 0 else "falls"
            reason = (
                f"from {scale.theta_at(inner):.3g} to {scale.theta_at(outer):.3g} the "
                f"amplitude {verb} by a factor of {math.exp(cliff.height):.2g} all at once"
            )
        else:
            good = settings.search.convergence.good
            edge = outermost_good(reference, side, good, settings.doubt)
            if not 0.0 < edge + side * settings.room < 1.0:
                continue
            limits[end] = float(f"{scale.theta_at(edge + side * settings.room):.3g}")
            reason = (
                f"beyond {scale.theta_at(edge):.3g} the oscillation is {good:g} times the best or "
                "worse"
            )
        name = f"theta_{'max' if end else 'min'}"
        limit = rig.theta_max if end else rig.theta_min
        why[end] = f"{name} {limits[end]:.3g} instead of {limit:g}: {reason}"
    return ThetaLimits(limits[0], limits[1], why[0], why[1])


def known_cliff(static_map: StaticMap, side: int, width: float) -> Cliff | None:
    """Return the cliff on a side (-1 or 1) if it is known within a width, in ranges."""
    cliff = static_map.cliff(side)
    if cliff is None or abs(static_map.u[cliff.outer] - static_map.u[cliff.inner]) > width:
        return None
    return cliff


def outermost_good(static_map: StaticMap, side: int, good: float, doubt: float) -> float:
    """Return the position furthest out on a side (-1 or 1) that may be good.

    That is ``good`` times the best one, less ``doubt`` standard errors.
    """
    curve = static_map.sense * static_map.curve(static_map.mean)
    grid = np.linspace(0.0, 1.0, GRID)
    error = np.interp(grid, static_map.u, static_map.error)
    inside = grid[curve - doubt * error < float(curve.min()) + math.log(good)]
    return float(inside[0] if side < 0 else inside[-1])
