"""Limits of the controller's theta: the valley of the best value seen, with room on both sides."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_tune.excitation.safe_range import SafeRange
from koop_tune.excitation.static_map import MAP, Cliff, StaticMap, fit_process, times_best
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.search.settings import TUNING, TuningSettings

SHARES = np.linspace(1.0, 0.25, 16).tolist()  # of the way from the best to a limit


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


def limit_corners(
    rig: RigFile,
    limits: Sequence[ThetaLimits],
    best: NDArray[np.float64],
    knobs: Sequence[int],
    holds: tuple[NDArray[np.float64], ...],
    settings: TuningSettings = TUNING,
) -> list[ThetaLimits]:
    """Return limits of several knobs, nearer to the best where they are far worse together.

    Along each knob they were found with the others at their best. In a valley that runs aslant
    beside a cliff, the others at their limits, a loop would meet what no section has seen.

    Parameters
    ----------
    rig : RigFile
        The rig, with n knobs.
    limits : sequence of ThetaLimits
        Limits of each along its section.
    best : ndarray, shape (n,)
        Position of the best.
    knobs : sequence of int
        Knobs that have an effect.
    holds : tuple of ndarray
        Positions, y and errors of all holds, as of :func:`koop_tune.excitation.bowl.fit_bowl`.
    settings : TuningSettings
        How much worse is far worse.
    """
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    u, y, error = holds
    around, chosen = np.full(len(knobs), 0.3), list(knobs)
    kernel = ConstantKernel(1.0, (0.01, 30.0)) * Matern(
        around, (MAP.shortest, 3.0), nu=MAP.smoothness
    ) + WhiteKernel(1e-4, (1e-6, MAP.scatter**2))
    process = fit_process(kernel, u[:, chosen], y - y.mean(), error)
    centre = best[chosen]
    ends = rig.u(np.transpose([limit[:2] for limit in limits]))[:, chosen]
    sides = np.array(list(itertools.product((0, 1), repeat=len(knobs))))
    ways = np.take_along_axis(ends, sides, axis=0) - centre
    least = float(process.predict(centre[None])[0])
    worst = [
        math.exp(float(process.predict(centre + share * ways).max()) - least) for share in SHARES
    ]
    share = next(
        (s for s, w in zip(SHARES, worst, strict=True) if w <= settings.corner), SHARES[-1]
    )
    if share == SHARES[0]:
        return list(limits)
    bad, nearer = times_best(worst[0], rig.sense), list(limits)
    for k, at, (low, high) in zip(chosen, centre, ends.T, strict=True):
        scale, (old, whys) = rig.scales[k], (limits[k][:2], ["", ""])
        new = [_round(scale.theta_at(at + share * (end - at)), scale) for end in (low, high)]
        for end, name in enumerate(("theta_min", "theta_max")):
            whys[end] = (
                f"{name} {new[end]:.10g} instead of {rig.each(name)[k]:g}: with each knob at its "
                f"limit, such as {old[end]:.4g}, the oscillation would be {bad}"
            )
        widest = tuple(
            n if w == o else w for n, w, o in zip(new, limits[k].widest, old, strict=False)
        )
        nearer[k] = ThetaLimits(new[0], new[1], whys[0], whys[1], widest)
    return nearer


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
