"""Maps of an excitation over each pair of knobs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from koop_commission.report.contents import Contents
from koop_commission.report.drawing import BEST, INTERFERENCE, MEASURED, OTHER, step_apart
from koop_tune.excitation.bowl import Array, Bowl, fit_bowl
from koop_tune.excitation.static_map import MAP
from koop_view.report.document import Figure, Panel, Series

WORSE = 3.0  # times the best, from which on a hold is far from it


def draw_pairs(c: Contents, knobs: Sequence[int]) -> Figure:
    """Return where theta was held over each pair of some knobs, and the valley of the bowl.

    The bowl fits all holds (:mod:`koop_tune.excitation.bowl`); its valley is that in which the
    other knobs are at their best.
    """
    holds, rig = c.excitation.holds, c.rig
    u, y, error = c.excitation.arrays(rig)
    bowl = fit_bowl(u[:, list(knobs)], y, error)
    above = np.exp(y - y.min())
    classes = (
        (f"within {MAP.good:g} times the best", above <= MAP.good, BEST),
        (f"within {WORSE:g} times", (above > MAP.good) & (above <= WORSE), MEASURED),
        ("more", above > WORSE, OTHER),
    )
    panels = []
    for i, j in combinations(range(len(knobs)), 2):
        a, b = rig.scales[knobs[i]], rig.scales[knobs[j]]
        at = np.array([[hold.theta[k] for k in (knobs[i], knobs[j])] for hold in holds])
        series = []
        for name, on, color in classes:
            x, y = at[on][np.argsort(at[on, 0], kind="stable")].T
            if x.size:
                x = step_apart(x.tolist(), a.high - a.low)
                series.append(Series(name, x, y.tolist(), "points", color=color))
        u, low, high = _cut_bowl(bowl, i, j)
        name = f"{MAP.good:g} times the least of the bowl"
        low, high = b.theta(low), b.theta(high)
        series.append(
            Series(name, a.theta(u).tolist(), low.tolist(), "band", high.tolist(), INTERFERENCE)
        )
        panels.append(
            Panel(rig.knob_names[knobs[i]], rig.knob_names[knobs[j]], tuple(series),
                  log_x=a.logarithmic, log_y=b.logarithmic)
        )  # fmt: skip
    caption = "Where theta was held over each pair of knobs, and the valley that fits all holds"
    return Figure("pairs", caption, tuple(panels), columns=2)


def _cut_bowl(bowl: Bowl, i: int, j: int) -> tuple[Array, Array, Array]:
    """Return positions of a knob, and those of another between which the bowl is a valley.

    p x^2 + 2 q x y + s y^2 = r^2   of the ways x and y from the best
    """
    (p, q), (_, s) = bowl.root[:, [i, j]].T @ bowl.root[:, [i, j]] + 1e-9 * np.eye(2)
    square = math.exp(bowl.floor) * (MAP.good**2 - 1.0)
    x = math.sqrt(square * s / (p * s - q * q)) * np.cos(np.linspace(math.pi, 0.0, 49))
    root = np.sqrt(np.maximum(square * s - (p * s - q * q) * x**2, 0.0))
    low, high = (np.clip(bowl.best[j] + (side * root - q * x) / s, 0.0, 1.0) for side in (-1, 1))
    u = bowl.best[i] + x
    inside = (u >= 0.0) & (u <= 1.0)
    return u[inside], low[inside], high[inside]
