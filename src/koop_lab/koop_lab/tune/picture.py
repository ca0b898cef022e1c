"""The picture of a tuning: static map, r against theta, and what theta will do."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from koop_lab.tune.static_map import GRID, StaticMap
from koop_lab.tune.tuning import Seen, Tuning

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

PATHS = 12  # of theta, that are drawn


def draw(seen: Seen, found: Tuning | None, path: Path, title: str) -> None:
    """Draw what was seen and, unless it was refused, what was found."""
    columns = 3 if found is not None else 1 + bool(seen.costs)
    figure, axes = plt.subplots(
        1, columns, figsize=(4.6 * columns, 3.8), layout="constrained", squeeze=False
    )
    figure.suptitle(title, fontsize=10)
    _map(axes[0, 0], seen, seen.amplitude, f"amplitude of {seen.feature}")
    best = seen.scale.theta_at(seen.amplitude.best())
    if found is not None:
        axes[0, 0].axvline(best, color="tab:green", linestyle="--", label=f"best, {best:.4g}")
        axes[0, 0].legend(fontsize="small")
    if seen.costs:
        axis = axes[0, 1]
        for judged in seen.costs:
            if not judged.maps:
                continue
            chosen = found is not None and judged.cost.name == found.chosen.cost.name
            maps = max(judged.maps.values(), key=lambda m: m.gain)
            if found is not None and chosen:
                maps = judged.maps[found.best.constants.omega_h]
            shift = maps.mean.min()
            r, wide = np.exp(2.0 * (maps.mean - shift)), np.exp(4.0 * maps.error)
            axis.errorbar(
                seen.scale.theta(seen.stays.u), r, [r - r / wide, r * wide - r], marker="o",
                markersize=3, linewidth=2.0 if chosen else 0.8, capsize=2, label=judged.cost.name,
            )  # fmt: skip
        axis.set_yscale("log")
        axis.set_title("r over its least, two standard errors", fontsize=10)
        _across(axis, seen)
        axis.legend(fontsize="x-small")
    if found is not None:
        axis = axes[0, 2]
        p = found.prediction
        t = (np.arange(p.runs[0].u.size) + 0.5) / p.runs[0].u.size * p.duration
        for run in p.runs[:PATHS]:
            axis.plot(t, seen.scale.theta(np.clip(run.u, 0.0, 1.0)), linewidth=0.8, alpha=0.7)
        axis.axhline(best, color="tab:green", linestyle="--")
        axis.set_xlabel("time [s]")
        axis.set_ylabel("theta")
        axis.set_title("theta, as predicted from both ends", fontsize=10)
        if seen.scale.logarithmic:
            axis.set_yscale("log")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _map(axis: Axes, seen: Seen, found: StaticMap, title: str) -> None:
    level = np.exp(found.mean)
    axis.errorbar(
        seen.scale.theta(found.u), level, 2.0 * found.error * level, fmt="o", capsize=3,
        markersize=4, label="seen, two standard errors",
    )  # fmt: skip
    grid = np.asarray(np.linspace(0.0, 1.0, GRID), np.float64)
    axis.plot(seen.scale.theta(grid), np.exp(found.curve(found.mean)), linewidth=1.0)
    axis.set_title(title, fontsize=10)
    axis.set_ylim(bottom=0.0)
    _across(axis, seen)


def _across(axis: Axes, seen: Seen) -> None:
    axis.set_xlabel("theta")
    if seen.scale.logarithmic:
        axis.set_xscale("log")
    axis.grid(alpha=0.3)
