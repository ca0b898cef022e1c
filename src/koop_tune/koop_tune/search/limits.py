"""Limits of the controller's theta: the valley of the best value seen, with room on both sides."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from koop_tune.excitation.safe_range import SafeRange
from koop_tune.excitation.static_map import Cliff, StaticMap, times_best
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.search.settings import TUNING, TuningSettings


class ThetaLimits(NamedTuple):
    """Limits of the controller's theta, and why each is narrower than the rig's.

    Attributes
    ----------
    low, high : float
        Least and largest theta.
    why_low, why_high : str
        Reasons in words; empty where it is the rig's.
    widest : tuple of float
        Least and largest theta to which they may open in operation; empty where they do not.
    """

    low: float
    high: float
    why_low: str = ""
    why_high: str = ""
    widest: tuple[float, ...] = ()

    @property
    def why(self) -> str:
        """Both, in words."""
        return "; ".join(why for why in (self.why_low, self.why_high) if why)


def limit_theta(
    static_map: StaticMap,
    rig: RigFile,
    settings: TuningSettings = TUNING,
    safe: SafeRange | None = None,
    motion: float = 0.0,
) -> ThetaLimits:
    """Return limits of the controller's theta: they contain the best value seen, with room.

    What is bad was seen once and need not be seen again: a swing that is wide while the optimum is
    sought, or a loop that noise leads astray, ends where the rig still oscillates little.

    A cliff wants more care. A loop goes a little beyond the optimum again and again; beyond a cliff
    the cost is so large that the filters forget it only slowly, and while they do theta moves on,
    whatever it does. So there theta stays a margin inside the last good value.

    An optimum that moves has as much more room as its ``motion`` [ranges]. Where it is lost in
    operation the limits open again, but not towards a cliff.

    Away from a constraint that ends the range on the other side theta keeps all of its way: there
    it must go if the bound moves.
    """
    scale, ends, why = rig.scale, [rig.theta_min, rig.theta_max], ["", ""]
    widest = ends.copy()
    best, valley = static_map.best(), static_map.valley(settings.limits)
    least = max(settings.least_room, 0.1 * valley.width)
    for end, side in ((0, -1), (1, 1)):
        if safe is not None and not safe.fixed and safe.ends(upper=not end):
            continue
        edge = valley[end]
        cliff = static_map.cliff(side)
        if cliff is not None:
            inside = side * (cliff.inner - best)
            u = best + side * max(
                inside - settings.margin, 0.5 * inside, 0.5 * abs(cliff.outer - best)
            )
            reason = _describe_cliff(cliff, static_map.sense, scale.theta_at)
        else:
            u = edge
            bad = times_best(settings.limits, static_map.sense)
            reason = f"beyond {scale.theta_at(edge):.4g} the oscillation is {bad} or worse"
        u = max(u, best + least) if end else min(u, best - least)
        u += side * max(side * motion, 0.0)
        if not 0.0 < u < 1.0:
            continue
        name, limit = ("theta_max", rig.theta_max) if end else ("theta_min", rig.theta_min)
        theta = min(max(_round(scale.theta_at(u), scale), rig.theta_min), rig.theta_max)
        if theta != limit:
            if cliff is not None:
                widest[end] = theta
            ends[end], why[end] = theta, f"{name} {theta:.10g} instead of {limit:g}: {reason}"
    open_to = tuple(widest) if widest != ends else ()
    return ThetaLimits(ends[0], ends[1], why[0], why[1], open_to)


def _round(theta: float, scale: Scale) -> float:
    """Return theta in four digits of its range, which may be narrow beside its values."""
    if scale.logarithmic:
        return float(f"{theta:.4g}")
    return round(theta, 4 - math.floor(math.log10(scale.high - scale.low)))


def _describe_cliff(cliff: Cliff, sense: float, theta_at: Callable[[float], float]) -> str:
    verb = "rises" if sense > 0 else "falls"
    return (
        f"from {theta_at(cliff.inner):.4g} to {theta_at(cliff.outer):.4g} the amplitude {verb} by "
        f"a factor of {math.exp(cliff.height):.3g} all at once"
    )
