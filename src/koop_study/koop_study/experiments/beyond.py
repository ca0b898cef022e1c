"""Experiment ``beyond``: other lifted costs and controllers, tuned alike, judged on fresh seeds.

Every candidate chooses its constants on the tuning seeds only; the figures that count come from
seeds that no choice has seen.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.experiments.ablations import label
from koop_study.experiments.spec import Seeds
from koop_study.experiments.stats import (
    SUMMARY_COLUMNS,
    column,
    finite,
    share,
    spread,
    summary_cells,
    win_rate,
)
from koop_study.simulation.case import Case, override
from koop_study.workers.units import Unit
from koop_view.report.document import Cell, Claim, Column, Figure, Panel, Section, Series, Table

SOUND = 100.0  # [%] converged that a cell must have on the tuning seeds to be preferred


@dataclass(frozen=True)
class Candidate:
    """A cost and a controller, with the constants that it may choose from.

    Attributes
    ----------
    name : str
        Of its row.
    idea : str
        What it tries, one sentence.
    settings : dict
        What makes it.
    grid : str
        Which of the experiment's grids tunes it; empty if nothing is tuned.
    """

    name: str
    idea: str
    settings: dict[str, Any]
    grid: str = ""


@dataclass(frozen=True)
class BeyondConfig:
    """Candidates, grids by name (setting to values), seeds to tune on and seeds to judge on."""

    candidates: tuple[Candidate, ...]
    grids: dict[str, dict[str, Any]]
    tuning: Seeds
    fresh: Seeds
    reference: str  # the candidate to beat: the raw cost's best cell
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if set(self.tuning.list()) & set(self.fresh.list()):
            raise ConfigError("tuning and fresh seeds overlap")
        names = [candidate.name for candidate in self.candidates]
        if self.reference not in names:
            raise ConfigError(
                f"reference '{self.reference}' is not a candidate: they are {', '.join(names)}"
            )
        for candidate in self.candidates:
            if candidate.grid and candidate.grid not in self.grids:
                raise ConfigError(f"{candidate.name}: there is no grid '{candidate.grid}'")
            for cell in self.cells(candidate):
                override(Case(), {**self.settings, **candidate.settings, **cell})

    def cells(self, candidate: Candidate) -> list[dict[str, Any]]:
        """Return the settings of every point of a candidate's grid; one empty one without."""
        grid = self.grids.get(candidate.grid, {})
        return [dict(zip(grid, point, strict=True)) for point in product(*grid.values())]


def steps(config: BeyondConfig) -> Generator[list[Unit], list[Any], Section]:
    """Tune, judge, report."""

    def unit(candidate: Candidate, cell: dict[str, Any], seeds: Seeds) -> Unit:
        settings = {**config.settings, **candidate.settings, **cell}
        return Unit("runs", {"settings": settings, "seeds": seeds.list()})

    pairs = [(c, cell) for c in config.candidates for cell in config.cells(c)]
    tuned = yield [unit(c, cell, config.tuning) for c, cell in pairs if c.grid]
    outcomes = iter(tuned)
    chosen: dict[str, tuple[dict[str, Any], Cell]] = {}
    for candidate in config.candidates:
        cells = config.cells(candidate)
        if candidate.grid:
            found = [next(outcomes) for _ in cells]
            best = min(range(len(cells)), key=lambda i: _rank(found[i]))
            chosen[candidate.name] = cells[best], spread(found[best], "iae").median
        else:
            chosen[candidate.name] = {}, None
    fresh = yield [unit(c, chosen[c.name][0], config.fresh) for c in config.candidates]
    rows = {c.name: found for c, found in zip(config.candidates, fresh, strict=True)}
    return _section(config, chosen, rows)


def _rank(rows: list[Any]) -> tuple[bool, float]:
    return share(rows, "converged") < SOUND, spread(rows, "iae").median


def _section(
    config: BeyondConfig,
    chosen: dict[str, tuple[dict[str, Any], Cell]],
    rows: dict[str, list[Any]],
) -> Section:
    table = Table(
        "beyond",
        f"Candidates at constants chosen on {config.tuning.count} tuning seeds, judged on "
        f"{config.fresh.count} fresh seeds",
        (
            Column("candidate", "candidate"),
            Column("constants", "constants chosen"),
            Column("tuning_iae", "IAE median, tuning", ".0f"),
            *SUMMARY_COLUMNS,
            Column("win_rate", f"wins against {config.reference} [%]", ".0f"),
        ),
    )
    for name, found in rows.items():
        cell, tuning_iae = chosen[name]
        constants = ", ".join(f"{key.split('.')[1]} {label(v)}" for key, v in cell.items())
        wins = win_rate(found, rows[config.reference]) if name != config.reference else None
        table.rows.append(
            (name, constants or "the default's", tuning_iae, *summary_cells(found), wins)
        )
    ideas = Table(
        "beyond_ideas",
        "What each candidate is",
        (Column("candidate", "candidate"), Column("idea", "idea")),
        [(candidate.name, candidate.idea) for candidate in config.candidates],
    )
    series = []
    for i, (name, found) in enumerate(rows.items()):
        values = np.sort([v for v in column(found, "iae") if finite(v) is not None])
        shares = (np.arange(values.size) + 1.0) / len(found) * 100.0
        series.append(Series(name, values.tolist(), shares.tolist(), "steps", color=i))
    figure = Figure(
        "beyond",
        "IAE on the fresh seeds, cumulative.",
        (Panel("IAE", "share of runs [%]", tuple(series), log_x=True),),
    )
    return Section(
        "beyond",
        "Beyond the paper",
        "Other costs and other controllers in the same loop. The relay's own cycle around θ* is as "
        "wide as the dwell time times the step and costs an IAE of about 600 however good the cost "
        "is; only another controller goes below that.",
        [table, ideas],
        [figure],
        _claims(config, table),
    )


def _claims(config: BeyondConfig, table: Table) -> list[Claim]:
    reference = float(table.cell(config.reference, "iae_median"))

    def median(name: str) -> float:
        text = table.cell(name, "iae_median")
        return float("inf") if text == "diverged" else float(text)

    claims = []
    for candidate in config.candidates:
        name = candidate.name
        if name == config.reference:
            continue
        verdict = "below" if median(name) < reference else "not below"
        claims.append(
            Claim(
                f"{name}: median IAE {table.cell(name, 'iae_median')} (90th percentile "
                f"{table.cell(name, 'iae_p90')}) on the fresh seeds with "
                f"{table.cell(name, 'converged')} % converged, {verdict} {config.reference} with "
                f"{table.cell(config.reference, 'iae_median')} "
                f"({table.cell(config.reference, 'converged')} % converged).",
                "beyond",
            )
        )
    return claims
