"""Experiment ``closed_loop``: the paper's closed-loop figures and table 4."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

from koop_loop.metrics import LOGGING_START, PAPER
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Series, Table

THETA_STAR = -3.0


@dataclass(frozen=True)
class ClosedLoopConfig:
    """Costs, each with settings of its own; everything else is as in the paper."""

    costs: dict[str, dict[str, Any]]
    settings: dict[str, Any] = field(default_factory=dict)


def units(config: ClosedLoopConfig) -> list[Unit]:
    """Return one unit a cost: the run, from the time on from which the paper logs."""
    return [
        Unit(
            "trace",
            {"settings": {**config.settings, **settings}, "seed": None, "start": LOGGING_START},
        )
        for settings in config.costs.values()
    ]


def section(config: ClosedLoopConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    table = Table(
        "closed_loop",
        "Performance (paper, table 4)",
        (
            Column("method", "method"),
            Column("iae", "IAE", ".0f"),
            Column("ise", "ISE", ".0f"),
            Column("t_theta", "T [s]", ".0f"),
            Column("e_r_ss", "e_r^ss", ".5f"),
            Column("tail", "mean error, last 30 %", ".3f"),
        ),
    )
    figures = []
    for cost, trace in zip(config.costs, results, strict=True):
        found = trace["metrics"]
        table.rows.append(
            (cost, *(found[name] for name in ("iae", "ise", "t_theta", "e_r_ss", "tail")))
        )
        figures.append(_figure(cost, trace))
    for name, paper in PAPER.items():
        table.rows.append(
            (
                f"paper, {name}",
                paper.iae_theta,
                paper.ise_theta,
                paper.t_theta,
                paper.e_r_ss,
                None,
            )
        )
    return Section(
        "closed_loop",
        "Closed loop",
        "One run of 2500 s for each cost, logged from 100 s on as in the paper; seed 0 draws the "
        "initial state and the training trajectories, the interference has the paper's phases.",
        [table],
        figures,
    )


def _figure(cost: str, trace: dict[str, Any]) -> Figure:
    def panel(name: str, label: str, color: int, *more: Series) -> Panel:
        low, high = trace[name]
        series = Series(label, trace["t"], low, "band", high, color)
        return Panel("t [s]", label, (series, *more))

    t = (trace["t"][0], trace["t"][-1])

    return Figure(
        f"closed_loop_{re.sub(r'[^a-z]+', '_', cost)}",
        f"Closed loop with the {cost} cost: true state, cost, θ with θ* dashed.",
        (
            panel("x", "x", 0),
            panel("r", "r", 1),
            panel("theta", "θ", 2, Series("θ*", t, (THETA_STAR, THETA_STAR), "level")),
        ),
    )
