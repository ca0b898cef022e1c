"""Experiment ``sensitivity``: both costs over omega_h x omega_l x tau_f."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from koop_study.experiments.spec import Seeds
from koop_study.experiments.stats import finite, share, spread, win_rate
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Heat, Panel, Section, Table
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

SOUND = 90.0  # [%] of the runs that must converge in a cell that counts as sound
Key = tuple[float, float, float]
DEFAULT: Key = (LifterConfig.omega_h, LifterConfig.omega_l, EscConfig.tau_f)


@dataclass(frozen=True)
class SensitivityConfig:
    """The grid of detector and filter constants, the costs, and the seeds of every cell."""

    omega_h: tuple[float, ...]
    omega_l: tuple[float, ...]
    tau_f: tuple[float, ...]
    seeds: Seeds
    costs: tuple[str, ...] = ("raw", "lifted")
    settings: dict[str, Any] = field(default_factory=dict)

    def cells(self) -> Iterator[Key]:
        """Return (omega_h, omega_l, tau_f) of every cell."""
        return product(self.omega_h, self.omega_l, self.tau_f)


def constants(omega_h: float, omega_l: float, tau_f: float) -> dict[str, float]:
    """Return the settings of a cell."""
    return {"lifter.omega_h": omega_h, "lifter.omega_l": omega_l, "esc.tau_f": tau_f}


def units(config: SensitivityConfig) -> list[Unit]:
    """Return one unit for every cost and cell."""
    return [
        Unit(
            "runs",
            {
                "settings": {**config.settings, **constants(*cell), "cost": cost},
                "seeds": config.seeds.list(),
            },
        )
        for cost in config.costs
        for cell in config.cells()
    ]


def section(config: SensitivityConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    cells = list(config.cells())
    rows = {
        cost: dict(zip(cells, results[i * len(cells) : (i + 1) * len(cells)], strict=True))
        for i, cost in enumerate(config.costs)
    }
    best = Table(
        "sensitivity",
        f"Each cost over {len(cells)} cells of ω_h × ω_l × τ_f, {config.seeds.count} seeds a cell; "
        f"a cell is sound if {SOUND:.0f} % of its runs converge",
        (
            Column("cost", "cost"),
            Column("sound", "sound cells [%]", ".0f"),
            Column("cells_won", "cells won against raw [%]", ".0f"),
            Column("runs_won", "runs won against raw [%]", ".0f"),
            Column("median_of_medians", "IAE, median cell", ".0f"),
            Column("default_iae", "IAE, default constants", ".0f"),
            Column("best_iae", "IAE, best cell", ".0f"),
            Column("best_p90", "IAE 90 %, best cell", ".0f"),
            Column("best_converged", "converged, best cell [%]", ".0f"),
            Column("omega_h", "ω_h best", "g"),
            Column("omega_l", "ω_l best", "g"),
            Column("tau_f", "τ_f best", "g"),
        ),
    )
    for cost, found in rows.items():
        medians = {cell: spread(r, "iae").median for cell, r in found.items()}
        top = min(medians, key=lambda cell: medians[cell])
        rivals = rows.get("raw") if cost != "raw" else None
        best.rows.append(
            (
                cost,
                100.0 * float(np.mean([share(r, "converged") >= SOUND for r in found.values()])),
                100.0 * float(np.mean([
                    medians[cell] < spread(rivals[cell], "iae").median for cell in cells
                ])) if rivals else None,
                float(np.mean([win_rate(found[cell], rivals[cell]) for cell in cells]))
                if rivals else None,
                float(np.median(list(medians.values()))),
                medians.get(DEFAULT),
                medians[top],
                spread(found[top], "iae").high,
                share(found[top], "converged"),
                *top,
            )
        )  # fmt: skip
    return Section(
        "sensitivity",
        "Sensitivity to the constants that the paper leaves open",
        "The paper gives no corner frequencies of the amplitude detector and no time constant of "
        "the relay's filter. So every cost meets the same grid of them. The "
        "detector's low-pass filter and the relay's filter are in series and commute: swapping ω_l "
        "and 1/τ_f gives nearly the same loop, which the maps show.",
        [best, _detail(rows)],
        [_figure(config, cost, found) for cost, found in rows.items()],
    )


def _detail(rows: dict[str, dict[Key, list[Any]]]) -> Table:
    table = Table(
        "sensitivity_cells",
        "Every cell",
        (
            Column("cost", "cost"),
            Column("omega_h", "ω_h", "g"),
            Column("omega_l", "ω_l", "g"),
            Column("tau_f", "τ_f", "g"),
            Column("iae_median", "IAE median", ".0f"),
            Column("iae_p10", "10 %", ".0f"),
            Column("iae_p90", "90 %", ".0f"),
            Column("converged", "converged [%]", ".0f"),
            Column("win_rate", "wins against raw [%]", ".0f"),
        ),
        detail=True,
    )
    for cost, found in rows.items():
        for cell, r in found.items():
            iae = spread(r, "iae")
            wins = win_rate(r, rows["raw"][cell]) if "raw" in rows and cost != "raw" else None
            table.rows.append(
                (cost, *cell, iae.median, iae.low, iae.high, share(r, "converged"), wins)
            )
    return table


def _figure(config: SensitivityConfig, cost: str, found: dict[Key, list[Any]]) -> Figure:
    panels = []
    for tau_f in config.tau_f:
        values = [
            [finite(spread(found[high, low, tau_f], "iae").median) for high in config.omega_h]
            for low in config.omega_l
        ]
        x, y = ([f"{v:g}" for v in axis] for axis in (config.omega_h, config.omega_l))
        heat = Heat(x, y, values, 600, 6000)
        title = f"{cost}, τ_f = {tau_f:g} s"
        panels.append(Panel("ω_h [rad/s]", "ω_l [rad/s]", title=title, heat=heat))
    return Figure(
        f"sensitivity_{cost}",
        f"Median IAE of the {cost} cost; one colour scale for all costs, from 600 (the relay's own "
        "cycle) to 6000, logarithmic.",
        tuple(panels),
        2,
    )
