"""Experiment ``laws``: the relay and the law ``adaptive`` on the paper's plant and on random rigs.

Both laws are tuned alike: as many trials of their constants on the same tuning seeds, drawn from
the same ranges; the trial with the least mean loss is judged, on fresh seeds and under scenarios
that it was not tuned for. Laws at fixed constants stand beside them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Generator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.experiments.spec import Seeds, parse
from koop_study.experiments.stats import cumulative, finite, quantile
from koop_study.family.config import FamilyConfig
from koop_study.family.scaled import LAWS, ScaledConstants
from koop_study.laws.plants import LawPlant, trials
from koop_study.simulation.case import Case, override
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Table

AT_ONCE = 4  # seeds of a unit of work
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class FixedLaw:
    """A law at constants that are given, not tuned: on the family, or on the other plants."""

    name: str
    constants: ScaledConstants
    family: bool = False


@dataclass(frozen=True)
class JudgedPlant:
    """A plant, the scenarios that a law is judged under, and the time to reacquire the optimum.

    Attributes
    ----------
    plant : LawPlant
        Plant that the laws are tuned on.
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
    """Plants with their scenarios, seeds, fixed laws, and how many trials tune each law."""

    plants: tuple[JudgedPlant, ...]
    trials: int
    tuning: Seeds
    fresh: Seeds
    fixed: tuple[FixedLaw, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)  # of every plant that is not a family

    def __post_init__(self) -> None:
        if set(self.tuning.list()) & set(self.fresh.list()):
            raise ConfigError("tuning and fresh seeds overlap")
        if not 1 <= self.trials <= 4096:
            raise ConfigError(f"trials = {self.trials}: must be 1 to 4096")
        if len({judged.plant.name for judged in self.plants}) < len(self.plants):
            raise ConfigError("plants: two have the same name")

    def described(self, plant: LawPlant) -> dict[str, Any]:
        """Return a plant in JSON terms, with the experiment's settings in force."""
        if plant.family:
            return asdict(plant)
        settings = {**plant.settings, **self.settings}
        duration = float(settings.pop("duration", plant.duration))
        return asdict(replace(plant, settings=settings, duration=duration))


def steps(config: LawsConfig) -> Generator[list[Unit], list[Any], Section]:
    """Tune, judge, report."""
    asked = [
        (judged.plant, law, seeds)
        for judged in config.plants
        for law in LAWS
        for seeds in _parts(config.tuning.list())
    ]
    losses = yield [
        Unit("law_trials",
             {"plant": config.described(plant), "law": law, "count": config.trials,
              "seeds": seeds})
        for plant, law, seeds in asked
    ]  # fmt: skip
    chosen: dict[tuple[str, str], ScaledConstants] = {}
    for judged in config.plants:
        name = judged.plant.name
        for law in LAWS:
            parts = [
                found for (plant, tuned, _), found in zip(asked, losses, strict=True)
                if (plant.name, tuned) == (name, law)
            ]  # fmt: skip
            best = int(np.argmin(np.mean(np.hstack(parts), axis=1)))
            chosen[name, f"{law}, tuned"] = trials(law, config.trials)[best]
    every = dict(chosen)
    for judged in config.plants:
        every |= {
            (judged.plant.name, law.name): law.constants
            for law in config.fixed
            if law.family == judged.plant.family
        }
    cells = [
        (judged, scenario, law, constants, seeds)
        for judged in config.plants
        for scenario in judged.scenarios
        for (plant, law), constants in every.items()
        if plant == judged.plant.name
        for seeds in _parts(config.fresh.list())
    ]
    units = [
        Unit("law_runs",
             {"plant": config.described(judged.under(scenario)), "constants": asdict(constants),
              "seeds": seeds})
        for judged, scenario, _, constants, seeds in cells
    ]  # fmt: skip
    results = yield units
    outcome: dict[tuple[str, str], dict[str, Rows]] = {}
    for (judged, scenario, law, _, _), found in zip(cells, results, strict=True):
        rows = outcome.setdefault((judged.plant.name, scenario), {})
        rows.setdefault(law, []).extend(found)
    return _section(config, chosen, outcome)


def _parts(seeds: list[int]) -> list[list[int]]:
    return [seeds[i : i + AT_ONCE] for i in range(0, len(seeds), AT_ONCE)]


def _values(rows: Rows, name: str) -> list[float]:
    return [math.inf if row[name] is None else float(row[name]) for row in rows]


def _table(judged: JudgedPlant, scenario: str, rows: dict[str, Rows]) -> Table:
    family = judged.plant.family
    score, unit = ("amplitude", "T") if family else ("IAE", "s")
    form = ".2f" if family else ".0f"
    table = Table(
        _slug(judged.plant.name, scenario),
        f"{judged.plant.name}, {scenario}: {len(next(iter(rows.values())))} fresh seeds",
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


def _section(
    config: LawsConfig,
    chosen: dict[tuple[str, str], ScaledConstants],
    outcome: dict[tuple[str, str], dict[str, Rows]],
) -> Section:
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
                f"{judged.plant.name}: scores of the fresh seeds, cumulative; further left is "
                "better.",
                tuple(panels),
                columns=2,
            )
        )
    constants = Table(
        "laws_constants",
        f"Constants chosen by {config.trials} trials on {config.tuning.count} tuning seeds; times "
        "in the plant's own, theta in its range",
        (Column("plant", "plant"), Column("law", "law"), Column("constants", "constants")),
        [
            (plant, law, ", ".join(f"{k} {v:.3g}" for k, v in asdict(c).items() if k != "law"))
            for (plant, law), c in chosen.items()
        ],
        detail=True,
    )
    return Section(
        "laws",
        "Laws",
        "The paper's relay and the law adaptive, both tuned with as many trials on the same seeds "
        "and judged on fresh ones. On the paper's plant the score is IAE; on the family, a random "
        "rig for each seed, it is the rms amplitude over the second half of a run over that of "
        "the best fixed θ, 1 at best; a run has failed where it did not converge, or is above "
        "1.5. The swing is the 5 to 95 % range of θ over the last 30 % of a run; T is a rig's "
        "slowest amplitude time and two periods.",
        [*tables, constants],
        figures,
    )


def _panel(judged: JudgedPlant, scenario: str, rows: dict[str, Rows]) -> Panel:
    curves = {name: _values(found, "score") for name, found in rows.items()}
    label = "amplitude over that of the best fixed θ" if judged.plant.family else "IAE"
    count = len(next(iter(curves.values())))
    return Panel(label, "share of runs [%]", cumulative(curves, count), scenario, log_x=True)
