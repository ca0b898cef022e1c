"""Experiment ``commission``: unknown rigs from the first sample to a damped oscillation.

Every rig of the family is excited, tuned and verified from either end of theta's range, offline, by
the code of ``koop excite`` and ``koop tune``; what it says is compared with the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from koop_core.config.objects import parse
from koop_core.config.parameter import ConfigError, Settings, parameter
from koop_study.experiments.seeds import Seeds
from koop_study.experiments.stats import quantile
from koop_study.family.config import FamilyConfig
from koop_study.family.settings import FAMILY
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Section, Table

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class RigSettings(Settings):
    """How each rig is drawn, excited, tuned and verified."""

    family: dict[str, Any] = field(default_factory=dict)
    """Settings of the family that all rigs have."""
    rate: float = parameter(
        0.5, "largest change of theta: ranges in the rig's own time", low=1e-4, high=1e4
    )
    excitation: float = parameter(
        400.0, "longest excitation: slowest times of the amplitude and ten periods", low=1.0,
        high=1e4,
    )  # fmt: skip
    duration: float = parameter(
        80.0, "run of verification, in the rig's own time", low=1.0, high=1e4
    )
    effort: float = parameter(1.0, "search budget (1 = default)", low=1e-3, high=1e3)

    @property
    def shared(self) -> dict[str, Any]:
        """Arguments that all units have, but the family."""
        return {name: getattr(self, name) for name in ("rate", "excitation", "duration", "effort")}


@dataclass(frozen=True)
class CommissionConfig(RigSettings):
    """Rigs of several strata."""

    rigs: Seeds
    """Seeds of the first stratum; each of the others has as many, the next ones."""
    strata: dict[str, dict[str, Any]]
    """Settings of the family of each stratum."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.strata:
            raise ConfigError("strata: needs at least one")
        for name in self.strata:
            parse(FamilyConfig, self.settings(name), f"strata: {name}")

    def settings(self, stratum: str) -> dict[str, Any]:
        """Return the settings of a stratum's family."""
        return {**self.strata[stratum], **self.family}


def units(config: CommissionConfig) -> list[Unit]:
    """Return one unit a rig."""
    first, count = config.rigs.first, config.rigs.count
    return [
        Unit("commission_plant",
             {"stratum": name, "family": config.settings(name), "seed": seed, **config.shared})
        for i, name in enumerate(config.strata)
        for seed in Seeds(first + i * count, count).list()
    ]  # fmt: skip


def section(config: CommissionConfig, results: Sequence[Any]) -> Section:
    """Report."""
    rows: list[Row] = list(results)
    return Section(
        "commission",
        "Commissioning",
        "Every rig is drawn at random, excited as koop excite does it, tuned as koop tune does it, "
        f"and its loop closed from either end of θ's range for {config.duration:g} times its own "
        "time (slowest time of the amplitude and two periods). The amplitude is the true one, "
        "root mean square over the second half, over that of the best fixed θ with the same "
        "noise; a rig counts as damped in truth if the worse side is within 1.5 and θ matters at "
        "all. A rig with an optimum that is refused counts as a failure; a refusal that says to "
        "leave θ at a limit is wrong only if that limit is not within 1.5 either.",
        [_summary(config, rows), _mistakes(rows)],
    )


def _worse(row: Row) -> float | None:
    """Return the true ratio of the worse side; None if no loop was closed."""
    return max(row["ratio"]) if "ratio" in row else None


def _is_good(row: Row) -> bool:
    ratio = _worse(row)
    return ratio is not None and ratio <= FAMILY.good


def _is_damped(row: Row) -> bool:
    return _is_good(row) and row["shape"] != "flat"


def _is_refused_rightly(row: Row) -> bool:
    """Return whether there is nothing to seek; of a limit that was advised, whether it is good."""
    if row["verdict"] in ("tuned", "error"):
        return False
    return bool(row["advised"] <= FAMILY.good if "advised" in row else not row["has_optimum"])


def _share(count: int, of: int) -> float | None:
    return 100.0 * count / of if of else None


def _summary(config: CommissionConfig, rows: list[Row]) -> Table:
    table = Table(
        "commission",
        "What commissioning says, and the truth: number of rigs",
        (
            Column("stratum", "rigs"),
            Column("rigs", "rigs", ".0f"),
            Column("optimum", "with an optimum", ".0f"),
            Column("wrongly", "of them refused wrongly", ".0f"),
            Column("success", "of them within 1.5 from either side [%]", ".1f"),
            Column("rightly", "without an optimum refused [%]", ".1f"),
            Column("damped", "said damped", ".0f"),
            Column("false_damped", "falsely damped", ".0f"),
            Column("false_not", "falsely not damped", ".0f"),
            Column("time", "excitation in the rig's own time, median", ".0f"),
        ),
    )
    strata = {name: [row for row in rows if row["stratum"] == name] for name in config.strata}
    for name, group in {**strata, "all": rows}.items():
        optimum = [row for row in group if row["has_optimum"]]
        without = [row for row in group if not row["has_optimum"]]
        table.rows.append(
            (
                name,
                len(group),
                len(optimum),
                sum(row["verdict"] != "tuned" and not _is_refused_rightly(row) for row in optimum),
                _share(sum(map(_is_good, optimum)), len(optimum)),
                _share(sum(map(_is_refused_rightly, without)), len(without)),
                sum(row["damped"] for row in group),
                sum(row["damped"] and not _is_damped(row) for row in group),
                sum(not row["damped"] and _is_good(row) for row in optimum),
                quantile([row["excited"] for row in group], 0.5),
            )
        )
    return table


def _mistakes(rows: list[Row]) -> Table:
    table = Table(
        "commission_mistakes",
        "Rigs that were refused wrongly, tuned wrongly, not damped, or of which a wrong word was "
        "said",
        (
            Column("seed", "seed", ".0f"),
            Column("stratum", "rigs"),
            Column("map", "map"),
            Column("verdict", "verdict"),
            Column("damped", "said damped"),
            Column("ratio", "amplitude over best fixed θ, worse side", ".2f"),
        ),
        detail=True,
    )
    for row in rows:
        if not (_is_refused_rightly(row) or (_is_damped(row) and row["damped"])):
            word = "yes" if row["damped"] else "no"
            table.rows.append(
                (row["seed"], row["stratum"], row["shape"], row["verdict"], word, _worse(row))
            )
    return table
