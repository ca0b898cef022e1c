"""Experiment ``knobs``: several knobs at once, on random rigs and on the paper's plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_core.config.objects import parse
from koop_core.config.parameter import ConfigError
from koop_study.experiments.commission import RigSettings
from koop_study.experiments.seeds import Seeds
from koop_study.experiments.stats import quantile
from koop_study.family.config import FamilyConfig
from koop_study.family.settings import FAMILY
from koop_study.simulation.case import case_of
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Section, Table

CONVERGED = 0.6  # |e| at the end, from 5: as in the tests of the paper's loop
MAP_COLUMNS = (
    Column("knobs", "knobs"),
    Column("condition", "condition", ".0f"),
    Column("useless", "one does nothing"),
    Column("amplitude", "amplitude over the best, median", ".2f"),
    Column("amplitude_p90", "90 %", ".2f"),
    Column("within", "within 1.5 [%]", ".0f"),
    Column("arrival", "dwell times until then, median", ".0f"),
)
COMMISSION_COLUMNS = (
    Column("knobs", "knobs"),
    Column("condition", "condition", ".0f"),
    Column("useless", "one does nothing"),
    Column("time", "time of the excitation [T], median", ".0f"),
    Column("holds", "holds, median", ".0f"),
    Column("held", "best hold within 1.5 of the best [%]", ".0f"),
    Column("tuned", "tuned [%]", ".0f"),
    Column("within", "loops within 1.5 from both corners, of the tuned [%]", ".0f"),
    Column("damped", "called damped [%]", ".0f"),
    Column("false", "falsely", "d"),
)
PLANT_COLUMNS = (
    Column("knobs", "knobs"),
    Column("iae", "IAE median", ".0f"),
    Column("iae_p90", "IAE 90 %", ".0f"),
    Column("distance", "distance at the end, median", ".2f"),
    Column("distance_max", "largest", ".2f"),
    Column("converged", f"at most {CONVERGED:g} [%]", ".0f"),
)
YARDSTICK_COLUMNS = (
    Column("yardstick", "yardstick"),
    Column("samples", "evaluations until reached, median", ".0f"),
    Column("samples_p90", "90 %", ".0f"),
    Column("reached", "reached [%]", ".0f"),
    Column("travel", "travel of an input until then [ranges]", ".2f"),
    Column("cost", "cost at the end", ".5g"),
    Column("source", "figure of the source"),
)
GRADIENT = (
    "time constants of 364 and 4000 s along the steep and the flat direction by a gradient law, "
)
SOURCES = {
    "mean square": "749 evaluations until it is 0.001 (cernml-extremum-seeking)",
    "quadratic, flat": f"{GRADIENT}100 s by Newton's (Ghaffari, Krstić and Nešić 2012)",
    "quadratic, steep": "the same",
    "wind farm": "3.4756 MW at first, 3.6559 MW at best (Krishnamoorthy's six turbines)",
}


@dataclass(frozen=True)
class Commissioned(RigSettings):
    """Rigs that are commissioned; the times are for each knob."""

    seeds: Seeds
    """Seeds of every row."""
    knobs: tuple[int, ...]
    """Numbers of knobs."""
    conditions: tuple[float, ...]
    """Condition numbers of their couplings."""

    def __post_init__(self) -> None:
        super().__post_init__()
        parse(FamilyConfig, self.family, "family")

    def rigs(self) -> list[tuple[int, float, bool]]:
        """Return knobs, condition and whether one does nothing, of each row."""
        return several(self.knobs, self.conditions)

    def units(self) -> list[Unit]:
        """Return one unit a rig."""
        return [
            Unit("commission_knobs",
                 {"n": n, "condition": condition, "useless": useless, "seed": seed,
                  "family": self.family, **self.shared})
            for n, condition, useless in self.rigs()
            for seed in self.seeds.list()
        ]  # fmt: skip

    def table(self, results: list[Any]) -> Table:
        """Return what became of the rigs."""
        count = self.seeds.count
        table = Table(
            "knobs_commission", f"Random rigs with several knobs commissioned, {count} of each",
            COMMISSION_COLUMNS,
        )  # fmt: skip
        for i, (n, condition, useless) in enumerate(self.rigs()):
            rows = results[i * count : (i + 1) * count]
            tuned = [row for row in rows if "ratio" in row]
            within = [max(row["ratio"]) <= FAMILY.good for row in tuned]
            damped = [row["damped"] for row in tuned]
            table.rows.append((
                str(n), condition, "yes" if useless else "no",
                quantile([row["excited"] for row in rows], 0.5),
                quantile([row["holds"] for row in rows], 0.5),
                100.0 * float(np.mean([row["held"] <= FAMILY.good for row in rows])),
                100.0 * len(tuned) / count, 100.0 * sum(within) / max(len(tuned), 1),
                100.0 * sum(damped) / count,
                sum(said and not true for said, true in zip(damped, within, strict=True)),
            ))  # fmt: skip
        return table


@dataclass(frozen=True)
class KnobsConfig:
    """What is run."""

    seeds: Seeds
    """Seeds of every row."""
    knobs: tuple[int, ...]
    """Numbers of knobs of the random rigs, from 1 to 8."""
    conditions: tuple[float, ...]
    """Condition numbers of their couplings."""
    duration: float
    """Length of a run on a random rig in dwell times."""
    plant_knobs: tuple[int, ...]
    """Numbers of knobs of the paper's plant."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Settings of its loop."""
    yardsticks: tuple[str, ...] = tuple(SOURCES)
    """Maps of others."""
    commissioned: Commissioned | None = None
    """Random rigs that are commissioned as well."""

    def __post_init__(self) -> None:
        for n in (*self.knobs, *self.plant_knobs):
            if not 1 <= n <= 8:
                raise ConfigError(f"{n} knobs: must be from 1 to 8")
        if not all(1.0 <= condition <= 1e6 for condition in self.conditions):
            raise ConfigError(f"conditions = {list(self.conditions)}: must be from 1 to 1e6")
        if not 10.0 <= self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration:g}: must be from 10 to 1e6 dwell times")
        if unknown := set(self.yardsticks) - set(SOURCES):
            raise ConfigError(f"yardsticks: no {min(unknown)!r}, there are {', '.join(SOURCES)}")
        case_of(self.settings)

    def maps(self) -> list[tuple[int, float, bool]]:
        """Return knobs, condition and whether one does nothing, of each row."""
        one = [(n, 1.0, False) for n in self.knobs if n == 1]
        return one + several(self.knobs, self.conditions)


def several(knobs: Sequence[int], conditions: Sequence[float]) -> list[tuple[int, float, bool]]:
    """Return knobs, condition and whether one does nothing, of every kind of rig with several."""
    return [(n, c, no) for n in knobs if n > 1 for c in conditions for no in (False, True)]


def units(config: KnobsConfig) -> list[Unit]:
    """Return one unit a row."""
    seeds = config.seeds.list()
    return [
        Unit("knobs_of_map", {"n": n, "condition": condition, "useless": useless, "seeds": seeds,
                              "duration": config.duration})
        for n, condition, useless in config.maps()
    ] + [
        Unit("knobs_of_plant", {"n": n, "settings": config.settings, "seeds": seeds})
        for n in config.plant_knobs
    ] + [
        Unit("seek_yardstick", {"name": name, "seeds": seeds}) for name in config.yardsticks
    ] + (config.commissioned.units() if config.commissioned else [])  # fmt: skip


def section(config: KnobsConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    count = config.seeds.count
    maps = Table("knobs", f"Random rigs with several knobs, {count} of each", MAP_COLUMNS)
    plant = Table(
        "knobs_plant", f"The paper's plant with several knobs, {count} seeds", PLANT_COLUMNS
    )
    cases = config.maps()
    for (n, condition, useless), rows in zip(cases, results[: len(cases)], strict=True):
        amplitude = [row["amplitude"] for row in rows]
        arrival = [np.inf if row["arrival"] is None else row["arrival"] for row in rows]
        within = 100.0 * float(np.mean(np.array(amplitude) <= FAMILY.good))
        maps.rows.append((
            str(n), condition, "yes" if useless else "no", quantile(amplitude, 0.5),
            quantile(amplitude, 0.9), within, quantile(arrival, 0.5),
        ))  # fmt: skip
    rest = results[len(cases) :]
    for n, rows in zip(config.plant_knobs, rest[: len(config.plant_knobs)], strict=True):
        iae, distance = ([row[name] for row in rows] for name in ("iae", "distance"))
        converged = 100.0 * float(np.mean(np.array(distance) <= CONVERGED))
        plant.rows.append((
            str(n), quantile(iae, 0.5), quantile(iae, 0.9), quantile(distance, 0.5), max(distance),
            converged,
        ))  # fmt: skip
    rest = rest[len(config.plant_knobs) :]
    others = Table("knobs_yardsticks", "Maps by which others have measured", YARDSTICK_COLUMNS)
    for name, rows in zip(config.yardsticks, rest, strict=False):
        samples = [np.inf if row["samples"] is None else row["samples"] for row in rows]
        others.rows.append((
            name, quantile(samples, 0.5), quantile(samples, 0.9),
            100.0 * float(np.mean(np.isfinite(samples))),
            quantile([row["travel"] for row in rows], 0.5),
            quantile([row["cost"] for row in rows], 0.5), SOURCES[name],
        ))  # fmt: skip
    tables = [maps, plant, others]
    if config.commissioned:
        tables.append(config.commissioned.table(rest[len(config.yardsticks) :]))
    text = (
        "The controller seeks along one direction after another (relay_esc/directions.py). The "
        "knobs are coupled, and of unequal worth by the condition number."
    )
    return Section("knobs", "Several knobs", text, tables, [])
