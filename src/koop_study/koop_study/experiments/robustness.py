"""Experiment ``robustness``: the distribution of every metric over many seeds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from koop_study.experiments.spec import Seeds
from koop_study.experiments.stats import (
    SUMMARY_COLUMNS,
    column,
    cumulative,
    spread,
    summary_cells,
    win_rate,
)
from koop_study.workers.units import Unit
from koop_view.report.document import Cell, Column, Figure, Panel, Section, Table

CHUNK = 8  # seeds a unit: short enough that a stopped study loses little


@dataclass(frozen=True)
class RobustnessConfig:
    """Costs, each with settings of its own, and the seeds that all of them meet."""

    seeds: Seeds
    costs: dict[str, dict[str, Any]]
    settings: dict[str, Any] = field(default_factory=dict)


def units(config: RobustnessConfig) -> list[Unit]:
    """Return one unit for every cost and chunk of seeds."""
    seeds = config.seeds.list()
    return [
        Unit(
            "runs",
            {
                "settings": {**config.settings, **settings},
                "seeds": seeds[start : start + CHUNK],
                "with_r_star": True,
            },
        )
        for settings in config.costs.values()
        for start in range(0, len(seeds), CHUNK)
    ]


def section(config: RobustnessConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    chunks = len(results) // len(config.costs)
    rows = {
        cost: [row for chunk in results[i * chunks : (i + 1) * chunks] for row in chunk]
        for i, cost in enumerate(config.costs)
    }
    summary = Table(
        "robustness",
        f"Metrics over {config.seeds.count} seeds: initial state, trained model and phase of the "
        "interference",
        (
            Column("cost", "cost"),
            *SUMMARY_COLUMNS,
            Column("e_r_ss_median", "e_r^ss median", ".5f"),
            Column("win_rate", "wins against raw [%]", ".0f"),
        ),
    )
    for cost, found in rows.items():
        wins: Cell = win_rate(found, rows["raw"]) if "raw" in rows and cost != "raw" else None
        summary.rows.append((cost, *summary_cells(found), spread(found, "e_r_ss").median, wins))
    detail = Table(
        "robustness_runs",
        "Every run",
        (
            Column("seed", "seed", "d"),
            Column("cost", "cost"),
            Column("iae", "IAE", ".0f"),
            Column("ise", "ISE", ".0f"),
            Column("t_theta", "T [s]", ".0f"),
            Column("e_r_ss", "e_r^ss", ".5f"),
            Column("tail", "mean error, last 30 %", ".3f"),
        ),
        detail=True,
    )
    for cost, found in rows.items():
        for seed, row in zip(config.seeds.list(), found, strict=True):
            detail.rows.append(
                (seed, cost, row["iae"], row["ise"], row["t_theta"], row["e_r_ss"], row["tail"])
            )
    return Section(
        "robustness",
        "Robustness",
        "The same seeds for every cost; a run counts as converged if the mean of |θ − θ*| over its "
        "last 30 % is at most 0.6, and as having reached θ* once |θ − θ*| < 0.1.",
        [summary, detail],
        [_figure(rows)],
    )


def _figure(rows: dict[str, list[Any]]) -> Figure:
    labels = {"iae": "IAE", "ise": "ISE", "t_theta": "T [s]", "e_r_ss": "e_r^ss"}
    panels = []
    for name, label in labels.items():
        curves = {cost: column(found, name) for cost, found in rows.items()}
        count = len(next(iter(curves.values())))
        panels.append(Panel(label, "share of runs [%]", cumulative(curves, count), log_x=True))
    return Figure(
        "robustness",
        "Cumulative distributions: how many of the runs stay at or below a value. A curve that "
        "ends below 100 % has runs in which that never happened.",
        tuple(panels),
        2,
    )
