"""Experiment ``laws``: the relay beside what the field would compare it with.

Every law is tuned alike: as many trials of its constants on the same tuning seeds, drawn from its
own ranges; the trial with the least mean loss is judged, on fresh seeds and under scenarios that it
was not tuned for. Laws at fixed constants stand beside them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Generator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError, nearest
from koop_study.experiments.spec import Seeds, parse
from koop_study.experiments.stats import finite, quantile
from koop_study.family.config import FamilyConfig
from koop_study.laws import outside
from koop_study.laws.catalogue import LAWS, Constants, trials
from koop_study.laws.plants import PlantConfig
from koop_study.simulation.case import Case, override
from koop_study.workers.units import Unit
from koop_view.report.document import Cell, Claim, Column, Figure, Panel, Section, Series, Table

AT_ONCE = 4  # seeds of a unit of work; a worker keeps as many plants for the next law's unit
Chosen = dict[tuple[str, str], Constants]  # by plant and law
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Fixed:
    """A law at constants that are given, not tuned: on the family, or on the other plants."""

    name: str
    law: str
    constants: dict[str, float]
    family: bool = False

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ConfigError(f"unknown law '{self.law}': {nearest(self.law, LAWS)}")
        known = LAWS[self.law].searched
        for name in self.constants:
            if name not in known:
                raise ConfigError(f"unknown constant '{name}': {nearest(name, known)}")
        if missing := [name for name in known if name not in self.constants]:
            raise ConfigError(f"'{self.name}' lacks {', '.join(missing)}")


@dataclass(frozen=True)
class Judged:
    """A plant, the scenarios that a law is judged under, and what counts as reacquired in time.

    Attributes
    ----------
    plant : PlantConfig
        What the laws are tuned on.
    scenarios : dict of str to dict
        Settings of the plant that each adds.
    brief : tuple of str
        Scenarios that are judged on the first ``few`` fresh seeds only.
    within : float
        Time in which an optimum that jumped is to be reached again: seconds, or the rig's times.
    """

    plant: PlantConfig
    scenarios: dict[str, dict[str, Any]]
    within: float
    brief: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.scenarios:
            raise ConfigError("scenarios: needs one at least")
        for name in self.brief:
            if name not in self.scenarios:
                raise ConfigError(f"brief: unknown scenario '{name}'")
        for name in ("", *self.scenarios):
            plant = self.under(name)
            if plant.family:
                parse(FamilyConfig, plant.settings, f"{plant.name}: {name}")
            else:
                override(Case(), {"cost": plant.cost, **plant.settings})

    def under(self, scenario: str) -> PlantConfig:
        """Return the plant under a scenario; without a name, as it is tuned."""
        added = self.scenarios.get(scenario, {})
        return replace(self.plant, settings={**self.plant.settings, **added})


@dataclass(frozen=True)
class Drawn:
    """What the figure of theta over time shows: laws, or fixed ones by name, on one plant."""

    plant: str
    scenario: str
    laws: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class LawsConfig:
    """Laws, plants with their scenarios, seeds, and how many trials tune each law.

    Attributes
    ----------
    few : int
        Fresh seeds of the scenarios that are looked at briefly.
    rivals : str
        Python of the laws that are other programs; they are left out without it.
    """

    laws: tuple[str, ...]
    plants: tuple[Judged, ...]
    trials: int
    tuning: Seeds
    fresh: Seeds
    drawn: Drawn
    few: int = 16
    fixed: tuple[Fixed, ...] = ()
    rivals: str = ""
    settings: dict[str, Any] = field(default_factory=dict)  # of every plant that is no family

    def __post_init__(self) -> None:
        if set(self.tuning.list()) & set(self.fresh.list()):
            raise ConfigError("tuning and fresh seeds overlap")
        named = {one.name for one in self.fixed}
        for law in (*self.laws, *(law for law in self.drawn.laws if law not in named)):
            if law not in LAWS:
                raise ConfigError(f"unknown law '{law}': {nearest(law, LAWS)}")
        if self.few < 1:
            raise ConfigError(f"few = {self.few}: must be at least 1")
        if not 1 <= self.trials <= 4096:
            raise ConfigError(f"trials = {self.trials}: must be 1 to 4096")
        plants = {judged.plant.name: judged for judged in self.plants}
        if len(plants) < len(self.plants):
            raise ConfigError("plants: two have the same name")
        if self.drawn.plant not in plants:
            raise ConfigError(f"drawn: unknown plant: {nearest(self.drawn.plant, plants)}")
        if self.drawn.scenario not in plants[self.drawn.plant].scenarios:
            raise ConfigError(f"drawn: the plant has no scenario '{self.drawn.scenario}'")

    @property
    def running(self) -> tuple[str, ...]:
        """Laws that run, in order."""
        return tuple(law for law in self.laws if self.rivals or law not in outside.NEEDED)

    def seeds(self, judged: Judged, scenario: str) -> list[int]:
        """Return the seeds that a scenario is judged on."""
        seeds = self.fresh.list()
        return seeds[: self.few] if scenario in judged.brief else seeds

    def law_of(self, name: str) -> str:
        """Return the law of a fixed row, or the law that is named."""
        return {one.name: one.law for one in self.fixed}.get(name, name)

    def needs(self) -> None:
        """Raise ConfigError if what the laws need is not there."""
        wanted = [law for law in self.laws if law in outside.NEEDED]
        if wanted and self.rivals:
            outside.check(self.rivals, wanted)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Laws that do not run."""
        return tuple(law for law in self.laws if law not in self.running)

    def described(self, plant: PlantConfig) -> dict[str, Any]:
        """Return a plant in JSON terms, with the experiment's settings in force."""
        settings = plant.settings if plant.family else {**plant.settings, **self.settings}
        duration = plant.duration
        if not plant.family:
            settings = dict(settings)
            duration = float(settings.pop("duration", duration))
        return asdict(replace(plant, settings=settings, duration=duration))

    def rows(self, plant: PlantConfig) -> list[tuple[str, str]]:
        """Return names and laws of a plant's rows."""
        fixed = [(one.name, one.law) for one in self.fixed if one.family == plant.family]
        return [*((LAWS[law].title, law) for law in self.running), *fixed]


def steps(config: LawsConfig) -> Generator[list[Unit], list[Any], Section]:
    """Tune, judge, report."""
    more = {"rivals": config.rivals}
    asked = [
        (judged.plant.name, law, seeds, config.described(judged.plant))
        for judged in config.plants
        for seeds in _parts(config.tuning.list(), AT_ONCE)
        for law in config.running
        if LAWS[law].ranges
    ]
    found = yield [
        Unit("law_trials",
             {"plant": plant, "law": law, "count": config.trials, "seeds": seeds,
              **(more if law in outside.NEEDED else {})})
        for _, law, seeds, plant in asked
    ]  # fmt: skip
    losses: dict[tuple[str, str], list[list[float]]] = {}
    for (plant, law, _, _), rows in zip(asked, found, strict=True):
        losses.setdefault((plant, law), []).extend(rows)
    chosen: Chosen = {}
    for (name, law), rows in losses.items():
        best = int(np.argmin(np.mean(rows, axis=0)))
        chosen[name, law] = trials(law, config.trials)[best]
    for judged in config.plants:
        chosen.update({(judged.plant.name, one.name): one.constants for one in config.fixed})
    cells = [
        (judged, scenario, seeds, name, law)
        for judged in config.plants
        for scenario in judged.scenarios
        for seeds in _parts(config.seeds(judged, scenario), AT_ONCE)
        for name, law in config.rows(judged.plant)
    ]

    def constants(plant: PlantConfig, name: str, law: str) -> Constants:
        return chosen.get((plant.name, name), chosen.get((plant.name, law), {}))

    units = [
        Unit("law_runs",
             {"plant": config.described(judged.under(scenario)), "law": law,
              "constants": constants(judged.plant, name, law), "seeds": seeds,
              **(more if law in outside.NEEDED else {})})
        for judged, scenario, seeds, name, law in cells
    ]  # fmt: skip
    shown = next(judged for judged in config.plants if judged.plant.name == config.drawn.plant)
    traced = [
        Unit("law_trace",
             {"plant": config.described(shown.under(config.drawn.scenario)),
              "law": config.law_of(name), "constants": constants(shown.plant, name, name),
              "seed": config.drawn.seed})
        for name in config.drawn.laws
    ]  # fmt: skip
    results = yield [*units, *traced]
    outcome: dict[tuple[str, str], dict[str, Rows]] = {}
    for (judged, scenario, _, name, _), found in zip(cells, results, strict=False):
        rows = outcome.setdefault((judged.plant.name, scenario), {})
        rows.setdefault(name, []).extend(found)
    return _section(config, chosen, outcome, results[len(units) :])


def _parts(seeds: list[int], size: int) -> list[list[int]]:
    return [seeds[i : i + size] for i in range(0, len(seeds), size)]


def _values(rows: Rows, name: str) -> list[float]:
    return [math.inf if row[name] is None else float(row[name]) for row in rows]


def _table(judged: Judged, scenario: str, rows: dict[str, Rows]) -> Table:
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
    chosen: Chosen,
    outcome: dict[tuple[str, str], dict[str, Rows]],
    traces: list[dict[str, Any]],
) -> Section:
    tables: list[Table] = []
    figures: list[Figure] = [_drawn(config, traces)]
    claims: list[Claim] = []
    for judged in config.plants:
        panels = []
        for scenario in judged.scenarios:
            rows = outcome[judged.plant.name, scenario]
            tables.append(_table(judged, scenario, rows))
            panels.append(_panel(judged, scenario, rows))
        claims.append(_claim(judged, tables[-len(judged.scenarios)]))
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
            (plant, LAWS[law].title, ", ".join(f"{k} {v:.3g}" for k, v in found.items()))
            for (plant, law), found in chosen.items()
            if law in LAWS
        ],
        detail=True,
    )
    without = ", ".join(LAWS[law].title for law in config.left_out)
    return Section(
        "laws",
        "Laws",
        "The relay beside what the field would compare it with, each tuned with as many trials on "
        "the same seeds and judged on fresh ones. On the paper's plant the score is IAE; on the "
        "family, a random rig for each seed, it is the rms amplitude over the second half of a run "
        "over that of the best fixed θ, 1 at best; a run has failed where it did not converge, or "
        "is above 1.5. The swing is the 5 to 95 % range of θ over the last 30 % of a run; T is a "
        "rig's slowest amplitude time and two periods."
        + (f" Left out, without --rivals: {without}." if without else ""),
        [*tables, constants],
        figures,
        claims,
    )


def _drawn(config: LawsConfig, traces: list[dict[str, Any]]) -> Figure:
    series = [
        Series(LAWS[name].title if name in LAWS else name, trace["t"], trace["theta"], color=i)
        for i, (name, trace) in enumerate(zip(config.drawn.laws, traces, strict=True))
    ]
    best = Series("θ*", traces[0]["t"], traces[0]["best"], "level")
    return Figure(
        "laws_theta",
        f"θ over time on {config.drawn.plant}, {config.drawn.scenario}, seed {config.drawn.seed}.",
        (Panel("t [s]", "θ", (*series, best)),),
        picture="theta.png",
    )


def _panel(judged: Judged, scenario: str, rows: dict[str, Rows]) -> Panel:
    series = []
    for i, (name, found) in enumerate(rows.items()):
        values = np.sort([v for v in _values(found, "score") if math.isfinite(v) and v > 0.0])
        if values.size:
            shares = (np.arange(values.size) + 1.0) / len(found) * 100.0
            series.append(Series(name, values.tolist(), shares.tolist(), "steps", color=i))
    label = "amplitude over that of the best fixed θ" if judged.plant.family else "IAE"
    return Panel(label, "share of runs [%]", tuple(series), title=scenario, log_x=True)


def _claim(judged: Judged, table: Table) -> Claim:
    def value(row: tuple[Cell, ...], i: int) -> float:
        return float(row[i] or 0.0)

    seeking = [row for row in table.rows if row[0] != LAWS["oracle"].title]
    best = min(seeking, key=lambda row: (value(row, 2), value(row, 1)))
    relay = next((row for row in seeking if row[0] == LAWS["relay"].title), best)
    texts = {row[0]: table.cell(row[0], "p90") for row in (best, relay)}
    medians = {row[0]: table.cell(row[0], "median") for row in (best, relay)}
    text = (
        f"{judged.plant.name}: the least 90th percentile has {best[0]}, {texts[best[0]]} with a "
        f"median of {medians[best[0]]}"
    )
    if best is not relay:
        text += f"; the relay has {texts[relay[0]]} and {medians[relay[0]]}"
    return Claim(text + ".", table.name)
