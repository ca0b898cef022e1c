"""Experiment ``cases``: closed loops, one row a case, the same columns in every table."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from koop_core.config.parameter import ConfigError, refuse_unknown
from koop_loop.metrics import PAPER
from koop_study.experiments.seeds import Seeds
from koop_study.experiments.stats import (
    COLUMNS,
    column,
    cumulative,
    spread,
    summary_cells,
)
from koop_study.simulation.case import Case, check_path, override
from koop_study.simulation.run import Row
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Series, Table
from vdp_plant.config import PlantConfig

AT_ONCE = 16  # seeds of a unit: short enough that a stopped study loses little
PAPER_COLUMNS = {"iae": "iae_theta", "ise": "ise_theta", "t_theta": "t_theta", "e_r_ss": "e_r_ss"}


class CaseOf(NamedTuple):
    """One row: the cost's name, the value that is varied, and the settings."""

    cost: str
    value: Any
    settings: dict[str, Any]


@dataclass(frozen=True)
class CaseTable:
    """A table: every cost with every value of what is varied."""

    name: str
    title: str
    """Name of table and figure; the varied quantity in words, with its unit."""
    parameters: tuple[str, ...] = ()
    """Settings that get the value; if a value is a list, each gets its own element."""
    values: tuple[Any, ...] = ()
    """The values; none: each cost as it is."""
    grid: tuple[Any, ...] = ()
    """In place of values, a list for each parameter: all combinations."""
    costs: tuple[str, ...] = ()
    """Empty: the experiment's costs."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Further settings of this table."""

    def __post_init__(self) -> None:
        for path in (*self.parameters, *self.settings):
            check_path(path)
        if not all(isinstance(values, list) for values in self.grid):
            raise ConfigError(f"grid = {list(self.grid)}: must be a list for each parameter")
        for value in self.varied():
            override(Case(), self.assign(value))

    def varied(self, count: int = 0) -> list[Any]:
        """Return the values that are run: all, or ``count`` of them, spread over the list."""
        values = list(map(list, itertools.product(*self.grid))) if self.grid else list(self.values)
        if 0 < count < len(values):
            picks = np.unique(np.rint(np.linspace(0, len(values) - 1, count)).astype(int))
            values = [values[i] for i in picks]
        return values or [None]

    def assign(self, value: Any) -> dict[str, Any]:
        """Return the settings for one value."""
        values = value if isinstance(value, list) else [value] * len(self.parameters)
        if len(values) != len(self.parameters):
            raise ConfigError(
                f"value {value} has {len(values)} elements for {len(self.parameters)} parameters"
            )
        return {**self.settings, **dict(zip(self.parameters, values, strict=True))}


@dataclass(frozen=True)
class CasesConfig:
    """Tables of cases."""

    title: str
    text: str
    """Heading and text of the report's part."""
    costs: dict[str, dict[str, Any]]
    """Names of the costs and their settings."""
    tables: tuple[CaseTable, ...]
    """What is run."""
    seeds: Seeds | None = None
    """Seeds of every case; None: one run as in the paper, drawn."""
    values: int = 0
    """Number of values of each table, spread over its list; 0 for all."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Settings of all cases."""

    def __post_init__(self) -> None:
        if not self.tables:
            raise ConfigError("tables: needs at least one")
        for table in self.tables:
            refuse_unknown(table.costs, self.costs, "cost", f"table {table.name}")

    def cases(self, table: CaseTable) -> Iterator[CaseOf]:
        """Yield the rows of a table."""
        for value in table.varied(self.values):
            for cost in table.costs or self.costs:
                settings = {**self.settings, **self.costs[cost], **table.assign(value)}
                yield CaseOf(cost, value, settings)

    def chunks(self) -> list[list[int]]:
        """Return the seeds of the units of one case."""
        seeds = [] if self.seeds is None else self.seeds.list()
        return [seeds[i : i + AT_ONCE] for i in range(0, len(seeds), AT_ONCE)]


def units(config: CasesConfig) -> list[Unit]:
    """Return the units of all tables, case by case."""
    result = []
    for table in config.tables:
        for case in config.cases(table):
            if config.seeds is None:
                result.append(Unit("trace", {"settings": case.settings}))
            for seeds in config.chunks():
                more = {} if table.parameters else {"with_r_star": True}
                arguments = {"settings": case.settings, "seeds": seeds, **more}
                result.append(Unit("runs", arguments))
    return result


def section(config: CasesConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    report = Section(config.tables[0].name, config.title, config.text)
    arriving = iter(results)
    for table in config.tables:
        cases = list(config.cases(table))
        if config.seeds is None:
            traces = list(itertools.islice(arriving, len(cases)))
            rows = [[trace["metrics"]] for trace in traces]
            report.figures += [
                _drawn(case.cost, trace) for case, trace in zip(cases, traces, strict=True)
            ]
        else:
            rows = [[row for _ in config.chunks() for row in next(arriving)] for _ in cases]
            report.figures.append(_figure(table, cases, rows, list(config.costs)))
        report.tables.append(_table(table, cases, rows))
        if config.seeds is None:
            report.tables[-1].rows += [_paper(name) for name in PAPER]
    return report


def _table(table: CaseTable, cases: list[CaseOf], rows: list[list[Row]]) -> Table:
    of_raw = {label(c.value): runs for c, runs in zip(cases, rows, strict=True) if c.cost == "raw"}
    value = (Column("value", table.title),) if table.parameters else ()
    columns = (Column("cost", "cost"), *value, *COLUMNS)
    made = Table(table.name, table.title, columns, detail=bool(table.parameters))
    for case, runs in zip(cases, rows, strict=True):
        rivals = None if case.cost == "raw" else of_raw.get(label(case.value))
        words = (case.cost, label(case.value)) if value else (case.cost,)
        made.rows.append((*words, *summary_cells(runs, rivals)))
    return made


def _paper(name: str) -> tuple[Any, ...]:
    """Return the row of a cost in the paper's table 4; None where the paper has no figure."""
    cells = {
        f"{key}_median": getattr(PAPER[name], attribute) for key, attribute in PAPER_COLUMNS.items()
    }
    return (f"paper, {name}", *(cells.get(column.key) for column in COLUMNS))


def label(value: Any) -> str:
    """Return a value as a table shows it."""
    if isinstance(value, list):
        return " / ".join(label(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _figure(
    table: CaseTable, cases: list[CaseOf], rows: list[list[Row]], costs: list[str]
) -> Figure:
    """Return the IAE over the values; of costs alone and of a grid, cumulative distributions."""
    by_cost: dict[str, list[list[Row]]] = {}
    for case, runs in zip(cases, rows, strict=True):
        by_cost.setdefault(case.cost, []).append(runs)
    if table.grid or not table.parameters:
        names = {"iae": "IAE", "ise": "ISE", "t_theta": "T [s]", "e_r_ss": "e_r^ss"}
        every = {cost: [row for runs in some for row in runs] for cost, some in by_cost.items()}
        panels = []
        for name, axis in names.items():
            curves = {cost: column(some, name) for cost, some in every.items()}
            count = len(next(iter(curves.values())))
            panels.append(Panel(axis, "share of runs [%]", cumulative(curves, count), log_x=True))
        caption = (
            "Cumulative distributions: how many of the runs stay at or below a value. A curve that "
            "ends below 100 % has runs in which that never happened."
        )
        return Figure(table.name, caption, tuple(p for p in panels if p.series), 2)
    values = [case.value for case in cases if case.cost == cases[0].cost]
    numeric = all(type(value) in (int, float) for value in values)
    x = [float(value) if numeric else float(i) for i, value in enumerate(values)]
    series = []
    for cost, some in by_cost.items():
        color, spreads = costs.index(cost), [spread(runs, "iae") for runs in some]
        low, median, high = (
            [getattr(s, name) for s in spreads] for name in ("low", "median", "high")
        )
        series += [
            Series(cost, x, low, "band", high, color),
            Series(cost, x, median, "line", color=color),
        ]
    log_x = numeric and min(x) > 0.0 and max(x) / min(x) >= 10.0
    ticks = () if numeric else tuple(label(value) for value in values)
    panel = Panel(table.title, "IAE", tuple(series), log_x=log_x, log_y=True, ticks=ticks)
    return Figure(table.name, f"{table.title}: IAE, median and 10–90 % band.", (panel,))


def _drawn(cost: str, trace: dict[str, Any]) -> Figure:
    t = (trace["t"][0], trace["t"][-1])
    best = Series("θ*", t, (PlantConfig.theta_star,) * 2, "level")
    panels = []
    for color, (name, axis) in enumerate((("x", "x"), ("r", "r"), ("theta", "θ"))):
        low, high = trace[name]
        series = Series(axis, trace["t"], low, "band", high, color)
        panels.append(Panel("t [s]", axis, (series, best) if name == "theta" else (series,)))
    return Figure(
        f"closed_loop_{re.sub(r'[^a-z]+', '_', cost)}",
        f"Closed loop with the {cost} cost: true state, cost, θ with θ* dashed.",
        tuple(panels),
    )
