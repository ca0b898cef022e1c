"""Experiment ``laws``: the relay and the law ``adaptive`` on the paper's plant and on random rigs.

Both laws have the same constants on all rigs, in units of each rig's own time and range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.experiments.spec import Seeds, parse
from koop_study.experiments.stats import cumulative, finite, quantile
from koop_study.family.config import FamilyConfig
from koop_study.family.scaled import ScaledConstants
from koop_study.laws.run import LawPlant
from koop_study.simulation.case import Case, override
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Table

AT_ONCE = 4  # seeds of a unit of work
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class ComparedLaw:
    """A law with its constants, on the paper's plant or on the family."""

    name: str
    constants: ScaledConstants
    family: bool = False


@dataclass(frozen=True)
class JudgedPlant:
    """A plant, the scenarios that a law is judged under, and the time to reacquire the optimum.

    Attributes
    ----------
    plant : LawPlant
        The plant.
    scenarios : dict of str to dict
        Settings of the plant that each adds.
    within : float
        Time in which an optimum that jumped is to be reached again: seconds, or the rig's times.
    """

    plant: LawPlant
    scenarios: dict[str, dict[str, Any]]
    within: float

    def __post_init__(self) -> None:
        if not self.scenarios:
            raise ConfigError("scenarios: needs at least one")
        for name in ("", *self.scenarios):
            plant = self.under(name)
            if plant.family:
                parse(FamilyConfig, plant.settings, f"{plant.name}: {name}")
            else:
                override(Case(), plant.paper_settings())

    def under(self, scenario: str) -> LawPlant:
        """Return the plant under a scenario; without a name, as it is tuned."""
        added = self.scenarios.get(scenario, {})
        return replace(self.plant, settings={**self.plant.settings, **added})


@dataclass(frozen=True)
class LawsConfig:
    """Laws, plants with their scenarios, and the seeds of every run."""

    laws: tuple[ComparedLaw, ...]
    plants: tuple[JudgedPlant, ...]
    seeds: Seeds
    settings: dict[str, Any] = field(default_factory=dict)  # of every plant that is not a family

    def __post_init__(self) -> None:
        if len({judged.plant.name for judged in self.plants}) < len(self.plants):
            raise ConfigError("plants: two have the same name")

    def described(self, plant: LawPlant) -> dict[str, Any]:
        """Return a plant in JSON terms, with the experiment's settings in force."""
        if plant.family:
            return asdict(plant)
        settings = {**plant.settings, **self.settings}
        duration = float(settings.pop("duration", plant.duration))
        return asdict(replace(plant, settings=settings, duration=duration))

    def cells(self) -> list[tuple[JudgedPlant, str, ComparedLaw, list[int]]]:
        """Return plant, scenario, law and seeds of every unit."""
        seeds = self.seeds.list()
        return [
            (judged, scenario, law, seeds[i : i + AT_ONCE])
            for judged in self.plants
            for scenario in judged.scenarios
            for law in self.laws
            if law.family == judged.plant.family
            for i in range(0, len(seeds), AT_ONCE)
        ]


def units(config: LawsConfig) -> list[Unit]:
    """Return the units of every plant, scenario and law."""
    return [
        Unit("law_runs",
             {"plant": config.described(judged.under(scenario)),
              "constants": asdict(law.constants), "seeds": seeds})
        for judged, scenario, law, seeds in config.cells()
    ]  # fmt: skip


def section(config: LawsConfig, results: Sequence[Any]) -> Section:
    """Return the part of the report."""
    outcome: dict[tuple[str, str], dict[str, Rows]] = {}
    for (judged, scenario, law, _), found in zip(config.cells(), results, strict=True):
        rows = outcome.setdefault((judged.plant.name, scenario), {})
        rows.setdefault(law.name, []).extend(found)
    tables: list[Table] = []
    figures: list[Figure] = []
    for judged in config.plants:
        panels = []
        for scenario in judged.scenarios:
            rows = outcome[judged.plant.name, scenario]
            tables.append(_table(judged, scenario, rows))
            panels.append(_panel(judged, scenario, rows))
        figures.append(
            Figure(
                _slug(judged.plant.name, "figure"),
                f"{judged.plant.name}: scores of all seeds, cumulative; further left is better.",
                tuple(panels),
                columns=2,
            )
        )
    return Section(
        "laws",
        "Laws",
        "The paper's relay and the law adaptive. On the paper's plant the score is IAE; on the "
        "family, a random rig for each seed, it is the rms amplitude over the second half of a run "
        "over that of the best fixed θ, 1 at best; a run has failed where it did not converge, or "
        "is above 1.5. The swing is the 5 to 95 % range of θ over the last 30 % of a run; T is a "
        "rig's slowest amplitude time and two periods.",
        tables,
        figures,
    )


def _values(rows: Rows, name: str) -> list[float]:
    return [math.inf if row[name] is None else float(row[name]) for row in rows]


def _table(judged: JudgedPlant, scenario: str, rows: dict[str, Rows]) -> Table:
    family = judged.plant.family
    score, unit = ("amplitude", "T") if family else ("IAE", "s")
    form = ".2f" if family else ".0f"
    table = Table(
        _slug(judged.plant.name, scenario),
        f"{judged.plant.name}, {scenario}: {len(next(iter(rows.values())))} seeds",
        (
            Column("law", "law"),
            Column("median", f"{score} median", form),
            Column("p90", f"{score} 90 %", form),
            Column("worst", f"{score} worst", form),
            Column("failed", "failed [%]", ".0f"),
            Column("swing", "swing [% of range]", ".1f"),
            Column("converged", f"first within bounds after [{unit}], median", ".0f"),
            Column("reacquired", f"reacquired after [{unit}], median", ".0f"),
            Column("in_time", f"reacquired within {judged.within:g} {unit} [%]", ".1f"),
        ),
        detail=scenario != next(iter(judged.scenarios)),
    )
    for name, found in rows.items():
        scores = _values(found, "score")
        again = [
            math.inf if value is None else value for row in found for value in row["reacquired"]
        ]
        in_time = 100.0 * float(np.mean([v <= judged.within for v in again])) if again else None
        table.rows.append(
            (
                name,
                quantile(scores, 0.5),
                quantile(scores, 0.9),
                max(scores),
                100.0 * float(np.mean(_values(found, "failed"))),
                100.0 * float(np.mean(_values(found, "swing"))),
                finite(quantile(_values(found, "converged"), 0.5)),
                finite(quantile(again, 0.5)) if again else None,
                in_time,
            )
        )
    return table


def _slug(plant: str, scenario: str) -> str:
    return "laws_" + re.sub(r"[^a-z0-9]+", "_", f"{plant} {scenario}".lower()).strip("_")


def _panel(judged: JudgedPlant, scenario: str, rows: dict[str, Rows]) -> Panel:
    curves = {name: _values(found, "score") for name, found in rows.items()}
    label = "amplitude over that of the best fixed θ" if judged.plant.family else "IAE"
    count = len(next(iter(curves.values())))
    return Panel(label, "share of runs [%]", cumulative(curves, count), scenario, log_x=True)
