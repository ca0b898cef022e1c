"""Experiment ``ablations``: one setting varied at a time, everything else at the default."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.experiments.spec import Seeds
from koop_study.experiments.stats import finite, share, spread
from koop_study.simulation.case import Case, check_path, override
from koop_study.workers.units import Unit
from koop_view.report.document import Cell, Column, Figure, Panel, Section, Series, Table


@dataclass(frozen=True)
class Ablation:
    """One setting and its values.

    Attributes
    ----------
    name : str
        Of the table and the figure.
    title : str
        The varied quantity in words, with its unit.
    parameters : tuple of str
        Settings that get the value; if a value is a list, each gets its own element.
    values : tuple
        The values.
    costs : tuple of str
        Empty: those of the experiment.
    settings : dict
        Further settings of this ablation.
    """

    name: str
    title: str
    parameters: tuple[str, ...]
    values: tuple[Any, ...]
    costs: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for path in (*self.parameters, *self.settings):
            check_path(path)
        for value in self.values:
            override(Case(), self.assign(value))

    def assign(self, value: Any) -> dict[str, Any]:
        """Return the settings for one value."""
        if isinstance(value, list):
            if len(value) != len(self.parameters):
                raise ConfigError(
                    f"value {value} has {len(value)} elements for {len(self.parameters)} parameters"
                )
            return {**self.settings, **dict(zip(self.parameters, value, strict=True))}
        return {**self.settings, **dict.fromkeys(self.parameters, value)}


@dataclass(frozen=True)
class AblationsConfig:
    """Costs with settings of their own, the seeds of every value, and the varied settings."""

    seeds: Seeds
    costs: dict[str, dict[str, Any]]
    ablations: tuple[Ablation, ...]
    values: int = 0  # of each ablation, spread over its list; 0 for all
    settings: dict[str, Any] = field(default_factory=dict)

    def chosen(self, ablation: Ablation) -> list[Any]:
        """Return the values that are run."""
        count = len(ablation.values)
        if not 0 < self.values < count:
            return list(ablation.values)
        picks = np.unique(np.rint(np.linspace(0, count - 1, self.values)).astype(int))
        return [ablation.values[i] for i in picks]

    def compared(self, ablation: Ablation) -> list[str]:
        """Return the costs that are run."""
        return list(ablation.costs or self.costs)


def units(config: AblationsConfig) -> list[Unit]:
    """Return one unit for every ablation, cost and value."""
    return [
        Unit(
            "runs",
            {
                "settings": {
                    **config.settings,
                    **config.costs[cost],
                    **ablation.assign(value),
                },
                "seeds": config.seeds.list(),
            },
        )
        for ablation in config.ablations
        for cost in config.compared(ablation)
        for value in config.chosen(ablation)
    ]


def section(config: AblationsConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    report = Section(
        "ablations",
        "Ablations",
        f"One setting at a time, {config.seeds.count} seeds a value; lines are medians, bands "
        "reach from the 10 to the 90 % quantile.",
    )
    queue = iter(results)
    for ablation in config.ablations:
        values = config.chosen(ablation)
        rows = {cost: [next(queue) for _ in values] for cost in config.compared(ablation)}
        report.tables.append(_table(ablation, [label(value) for value in values], rows))
        report.figures.append(_figure(ablation, values, rows, list(config.costs)))
    return report


def label(value: Any) -> str:
    """Return a value as a table shows it."""
    if isinstance(value, list):
        return " / ".join(label(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _table(ablation: Ablation, labels: list[str], rows: dict[str, list[Any]]) -> Table:
    columns = [Column("value", ablation.title)]
    for cost in rows:
        columns += [
            Column(f"{cost}_iae_median", f"{cost}: IAE median", ".0f"),
            Column(f"{cost}_iae_p10", "10 %", ".0f"),
            Column(f"{cost}_iae_p90", "90 %", ".0f"),
            Column(f"{cost}_converged", "converged [%]", ".0f"),
        ]
    table = Table(f"ablation_{ablation.name}", ablation.title, tuple(columns), detail=True)
    for i, text in enumerate(labels):
        cells: list[Cell] = [text]
        for found in rows.values():
            iae = spread(found[i], "iae")
            cells += [iae.median, iae.low, iae.high, share(found[i], "converged")]
        table.rows.append(tuple(cells))
    return table


def _figure(
    ablation: Ablation, values: list[Any], rows: dict[str, list[Any]], costs: list[str]
) -> Figure:
    numeric = all(type(value) in (int, float) for value in values)
    x = [float(value) if numeric else float(i) for i, value in enumerate(values)]
    positive = numeric and min(x) > 0.0 and max(x) / min(x) >= 10.0
    series = []
    for cost, found in rows.items():
        color = costs.index(cost)  # the same colour in every figure
        spreads = [spread(r, "iae") for r in found]
        series += [
            Series(
                cost, x, [finite(s.low) for s in spreads], "band",
                [finite(s.high) for s in spreads], color,
            ),
            Series(cost, x, [finite(s.median) for s in spreads], "line", color=color),
        ]  # fmt: skip
    return Figure(
        f"ablation_{ablation.name}",
        f"{ablation.title}: IAE, median and 10–90 % band.",
        (
            Panel(
                ablation.title, "IAE", tuple(series), log_x=positive, log_y=True,
                ticks=() if numeric else tuple(label(value) for value in values),
            ),
        ),
    )  # fmt: skip
