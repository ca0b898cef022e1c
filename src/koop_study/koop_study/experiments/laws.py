"""Experiment ``laws``: the relay and the law ``adaptive`` on the paper's plant and on random rigs.

Both laws have the same constants on all rigs, in units of each rig's own time and range.
"""

from __future__ import annotations

import math
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
COLUMNS = (
    Column("plant", "plant, scenario, law"),
    Column("median", "score, median", ".2f"),
    Column("p90", "90 %", ".2f"),
    Column("worst", "worst", ".2f"),
    Column("failed", "failed [%]", ".0f"),
    Column("reacquired", "reacquired after [s], median", ".0f"),
    Column("in_time", "reacquired in time [%]", ".1f"),
)


@dataclass(frozen=True)
class ComparedLaw:
    """A law with its constants, on the paper's plant or on the family."""

    name: str
    constants: ScaledConstants
    family: bool = False


@dataclass(frozen=True)
class JudgedPlant:
    """A plant, and the scenarios under which a law is judged: settings that each adds."""

    plant: LawPlant
    scenarios: dict[str, dict[str, Any]]

    def __post_init__(self) -> None:
        for name in self.scenarios:
            plant = self.under(name)
            if plant.family:
                parse(FamilyConfig, plant.settings, f"{plant.name}: {name}")
            else:
                override(Case(), plant.paper_settings())

    def under(self, scenario: str) -> LawPlant:
        """Return the plant under a scenario."""
        return replace(self.plant, settings={**self.plant.settings, **self.scenarios[scenario]})


@dataclass(frozen=True)
class LawsConfig:
    """Laws, plants with their scenarios, and the seeds of every run.

    Attributes
    ----------
    within : float
        Time in which an optimum that jumped is to be reached again [s].
    settings : dict
        Settings of every plant that is not a family.
    """

    laws: tuple[ComparedLaw, ...]
    plants: tuple[JudgedPlant, ...]
    seeds: Seeds
    within: float
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len({judged.plant.name for judged in self.plants}) < len(self.plants):
            raise ConfigError("plants: two have the same name")

    def cells(self) -> list[tuple[LawPlant, str, ComparedLaw, list[int]]]:
        """Return plant, scenario, law and seeds of every unit."""
        seeds = self.seeds.list()
        return [
            (judged.under(scenario), scenario, law, seeds[i : i + AT_ONCE])
            for judged in self.plants
            for scenario in judged.scenarios
            for law in self.laws
            if law.family == judged.plant.family
            for i in range(0, len(seeds), AT_ONCE)
        ]


def units(config: LawsConfig) -> list[Unit]:
    """Return the units of every plant, scenario and law."""
    result = []
    for plant, _, law, seeds in config.cells():
        described = asdict(plant)
        if not plant.family:
            described["settings"] = {**plant.settings, **config.settings}
        arguments = {"plant": described, "constants": asdict(law.constants), "seeds": seeds}
        result.append(Unit("law_runs", arguments))
    return result


def section(config: LawsConfig, results: Sequence[Any]) -> Section:
    """Return the part of the report."""
    rows: dict[tuple[str, str], dict[str, list[dict[str, Any]]]] = {}
    for (plant, scenario, law, _), some in zip(config.cells(), results, strict=True):
        rows.setdefault((plant.name, scenario), {}).setdefault(law.name, []).extend(some)
    table, panels = Table("laws", f"{config.seeds.count} seeds", COLUMNS), []
    for (name, scenario), laws in rows.items():
        scores = {of: [row["score"] for row in some] for of, some in laws.items()}
        for law_name, some in laws.items():
            again = [math.inf if t is None else t for row in some for t in row["reacquired"]]
            table.rows.append(
                (
                    f"{name}, {scenario}: {law_name}",
                    quantile(scores[law_name], 0.5),
                    quantile(scores[law_name], 0.9),
                    max(scores[law_name]),
                    100.0 * float(np.mean([row["failed"] for row in some])),
                    finite(quantile(again, 0.5)) if again else None,
                    100.0 * float(np.mean([t <= config.within for t in again])) if again else None,
                )
            )
        curves = cumulative(scores, config.seeds.count)
        title = f"{name}, {scenario}"
        panels.append(Panel("score", "share of runs [%]", curves, title, log_x=True))
    return Section(
        "laws",
        "Laws",
        "The paper's relay and the law adaptive. On the paper's plant the score is IAE; on the "
        "family, a random rig for each seed, it is the rms amplitude over the second half of a run "
        "over that of the best fixed θ, 1 at best; a run has failed where it did not converge, or "
        f"is above 1.5. In time is within {config.within:g} s.",
        [table],
        [Figure("laws", "Scores of all seeds; further left is better.", tuple(panels), 2)],
    )
