"""Experiment ``commission``: unknown rigs from the first sample to a damped oscillation.

Every rig of the family is excited, tuned and verified from either end of theta's range, offline, by
the code of ``koop excite`` and ``koop tune``, beside simpler ways to choose the constants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from koop_core.config.parameter import ConfigError, nearest
from koop_study.experiments.spec import Seeds, parse
from koop_study.experiments.stats import cumulative, quantile
from koop_study.family.config import WITH_OPTIMUM, FamilyConfig
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Table

GOOD = 1.5
COMMISSIONED = "koop excite, tune, verify: at most three rounds"
VERDICTS = ("tuned", "monotone", "flat", "drowned", "error")
GRID = ("law", "omega_h", "omega_l", "speed", "dwell", "tau_f")
Row = dict[str, Any]


@dataclass(frozen=True)
class CommissionConfig:
    """Rigs, and how long each may be excited and is verified.

    Attributes
    ----------
    rigs : Seeds
        One rig a seed.
    family : dict
        Settings of the family.
    rate : float
        Largest change of theta: ranges in the rig's own time.
    excitation : float
        Longest time of an excitation: slowest times of the amplitude and ten periods.
    duration : float
        Of a run of verification, in the rig's own time.
    effort : float
        Of the search for constants, in units of the usual one.
    grid : dict of str to tuple
        Constants in units of the rig's own, of which the oracle takes the best combination.
    """

    rigs: Seeds
    grid: dict[str, Any]
    family: dict[str, Any] = field(default_factory=dict)
    rate: float = 0.5
    excitation: float = 400.0
    duration: float = 80.0
    effort: float = 1.0

    def __post_init__(self) -> None:
        parse(FamilyConfig, self.family, "family")
        for name in ("rate", "excitation", "duration", "effort"):
            if not 0.0 < getattr(self, name) <= 1e4:
                raise ConfigError(f"{name} = {getattr(self, name):g}: must be above 0, at most 1e4")
        for name in self.grid:
            if name not in GRID:
                raise ConfigError(f"grid: unknown constant '{name}': {nearest(name, GRID)}")
        if missing := [name for name in GRID if name not in self.grid]:
            raise ConfigError(f"grid: lacks {', '.join(missing)}")


def units(config: CommissionConfig) -> list[Unit]:
    """Return one unit a rig."""
    return [
        Unit("commission_plant",
             {"family": config.family, "seed": seed, "rate": config.rate,
              "excitation": config.excitation, "duration": config.duration,
              "effort": config.effort, "grid": config.grid})
        for seed in config.rigs.list()
    ]  # fmt: skip


def section(config: CommissionConfig, results: Sequence[Any]) -> Section:
    """Report."""
    rows: list[Row] = list(results)
    ways: dict[str, Callable[[Row], Row | None]] = {
        COMMISSIONED: lambda row: row["runs"].get("tuned"),
        "the first round of it": lambda row: row["runs"].get("first"),
        "best of the grid for each rig (oracle)": lambda row: row["runs"]["grid"],
        "scaled by hand": lambda row: row["runs"]["scaled"],
        "defaults": lambda row: row["runs"]["defaults"],
    }
    with_optimum = [row for row in rows if row["shape"] in WITH_OPTIMUM]
    summary = _summary(ways, with_optimum, len(rows))
    refusals, rounds = _refusals(rows), _rounds(with_optimum)
    kinds = _kinds(ways, with_optimum)
    figure = Figure(
        "commission_figure",
        "Amplitude over that at the best fixed θ, from the worse side; cumulative over the rigs.",
        (_panel(ways, with_optimum),),
    )
    return Section(
        "commission",
        "Commissioning",
        "Every rig is drawn at random, excited as koop excite does it, tuned as koop tune does it, "
        f"and its loop closed from either end of θ's range for {config.duration:g} times its own "
        "time (slowest time of the amplitude and two periods). The amplitude is the true one, "
        "root mean square over the second half, over that of the best fixed θ with the same "
        "noise; a rig counts as a success if the worse side is within 1.5. A rig with an optimum "
        "that is refused counts as a failure. The best of the grid is chosen by the outcome; "
        "'scaled by hand' are the node's defaults in units of each rig's true time and frequency. "
        "They are given the cost that koop tune chose, raw where it refused; 'defaults' take raw "
        "and know the rig's limits and dt.",
        [summary, refusals, rounds, kinds],
        [figure],
    )


def _share(count: int, of: int) -> float | None:
    return 100.0 * count / of if of else None


def _summary(ways: dict[str, Callable[[Row], Row | None]], rows: list[Row], every: int) -> Table:
    total = len(rows)
    table = Table(
        "commission",
        f"{total} rigs with an optimum, of {every}",
        (
            Column("way", "constants"),
            Column("success", "within 1.5 from either side [%]", ".1f"),
            Column("tried", "rigs", ".0f"),
            Column("median", "amplitude over best fixed θ, median", ".2f"),
            Column("p90", "90 %", ".2f"),
            Column("oracle", "amplitude over oracle's, median", ".2f"),
            Column("converged", "within bounds after [share of run], median", ".2f"),
        ),
    )
    for name, way in ways.items():
        pairs = [(row, run) for row in rows if (run := way(row)) is not None]
        ratios = [max(run["ratio"]) for _, run in pairs]
        beside = [max(run["ratio"]) / max(row["runs"]["grid"]["ratio"]) for row, run in pairs]
        slow = [max(run["converged"]) for _, run in pairs]
        table.rows.append(
            (
                name,
                _share(sum(ratio <= GOOD for ratio in ratios), total),
                len(pairs),
                quantile(ratios, 0.5) if pairs else None,
                quantile(ratios, 0.9) if pairs else None,
                quantile(beside, 0.5) if pairs else None,
                quantile(slow, 0.5) if pairs else None,
            )
        )
    return table


def _refusals(rows: list[Row]) -> Table:
    table = Table(
        "commission_verdicts",
        "Verdict of koop tune by the rig's map: number of rigs",
        (
            Column("map", "map"),
            Column("rigs", "rigs", ".0f"),
            *(Column(name, name, ".0f") for name in VERDICTS),
            Column("right", "right [%]", ".1f"),
        ),
    )
    groups = {name: [row for row in rows if row["shape"] == name] for name in
              dict.fromkeys([*WITH_OPTIMUM, *(row["shape"] for row in rows)])}  # fmt: skip
    groups["all with an optimum"] = [row for row in rows if row["shape"] in WITH_OPTIMUM]
    groups["all without"] = [row for row in rows if row["shape"] not in WITH_OPTIMUM]
    for name, own in groups.items():
        if own:
            there = own[0]["shape"] in WITH_OPTIMUM
            counts = [sum(row["verdict"] == verdict for row in own) for verdict in VERDICTS]
            right = counts[0] if there else sum(counts[1:-1])
            table.rows.append((name, len(own), *counts, _share(right, len(own))))
    return table


def _rounds(rows: list[Row]) -> Table:
    table = Table(
        "commission_rounds",
        "Verdict of the verification and the truth: rigs that were tuned",
        (
            Column("says", "verification"),
            Column("rigs", "rigs", ".0f"),
            Column("good", "truly within 1.5", ".0f"),
        ),
    )
    told = [row for row in rows if "rounds" in row]
    groups = {
        f"damped as predicted, in round {number}": [
            row for row in told if row["damped_as_predicted"] and row["rounds"] == number
        ]
        for number in sorted({row["rounds"] for row in told})
    }
    groups["not as predicted, after the last round"] = [
        row for row in told if not row["damped_as_predicted"]
    ]
    for name, own in groups.items():
        good = sum(max(row["runs"]["tuned"]["ratio"]) <= GOOD for row in own)
        table.rows.append((name, len(own), good))
    return table


KINDS: dict[str, Callable[[Row], bool]] = {
    "limit cycle": lambda row: not row["noise_driven"],
    "noise-driven": lambda row: bool(row["noise_driven"]),
    "one channel": lambda row: row["channels"] == 1,
    "amplitude time up to 20 periods": lambda row: row["slowest"] <= 20.0,
    "amplitude time above 20 periods": lambda row: row["slowest"] > 20.0,
    "no interference": lambda row: row["interference"] == 0.0,
    "interference above the signal": lambda row: row["interference"] > 1.0,
    "measurement noise above 10 %": lambda row: row["noise"] > 0.1,
    "θ on a log scale": lambda row: bool(row["logarithmic"]),
    "maximised": lambda row: bool(row["maximised"]),
    **{f"map {name}": lambda row, name=name: row["shape"] == name for name in WITH_OPTIMUM},  # type: ignore[misc]
}


def _kinds(ways: dict[str, Callable[[Row], Row | None]], rows: list[Row]) -> Table:
    shown = (COMMISSIONED, "best of the grid for each rig (oracle)")
    table = Table(
        "commission_kinds",
        "The same by kind of rig",
        (
            Column("kind", "rigs that are"),
            Column("rigs", "rigs", ".0f"),
            Column("refused", "refused", ".0f"),
            Column("success", "within 1.5 [%]", ".1f"),
            Column("median", "amplitude over best fixed θ, median", ".2f"),
            Column("oracle", "oracle within 1.5 [%]", ".1f"),
        ),
    )
    for name, belongs in KINDS.items():
        own = [row for row in rows if belongs(row)]
        tuned, oracle = (
            [max(run["ratio"]) for row in own if (run := ways[way](row)) is not None]
            for way in shown
        )
        table.rows.append(
            (
                name,
                len(own),
                len(own) - len(tuned),
                _share(sum(ratio <= GOOD for ratio in tuned), len(own)),
                quantile(tuned, 0.5) if tuned else None,
                _share(sum(ratio <= GOOD for ratio in oracle), len(own)),
            )
        )
    return table


def _panel(ways: dict[str, Callable[[Row], Row | None]], rows: list[Row]) -> Panel:
    curves = {
        name: [max(run["ratio"]) for row in rows if (run := way(row)) is not None]
        for name, way in ways.items()
    }
    label = "amplitude over that at the best fixed θ"
    return Panel(label, "share of rigs [%]", cumulative(curves, len(rows)), log_x=True)
