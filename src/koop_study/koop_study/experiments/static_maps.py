"""Experiment ``static_maps``: r(theta) along ramps and settled, and how convex it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.simulation import maps
from koop_study.workers.units import Unit
from koop_view.report.document import Cell, Column, Figure, Panel, Section, Series, Table

THETA_STAR = -3.0
SHARED = ("esc.dt", "esc.theta_initial")  # must be the plant's


@dataclass(frozen=True)
class StaticMapsConfig:
    """Costs, each with settings of its own, and durations of the ramp [s]."""

    costs: dict[str, dict[str, Any]]
    ramps: tuple[float, ...]
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in [name for given in (self.settings, *self.costs.values()) for name in given]:
            if name.startswith("esc.") and name not in SHARED:
                raise ConfigError(f"{name}: has no effect on a static map: theta is given there")
            if name == "duration":
                raise ConfigError("duration: a static map takes its length from 'ramps'")


def units(config: StaticMapsConfig) -> list[Unit]:
    """Return one unit a ramp and one a settled map, for every cost."""
    result = []
    for settings in config.costs.values():
        merged = {"settings": {**config.settings, **settings}, "seed": None}
        result += [Unit("ramp", {**merged, "duration": duration}) for duration in config.ramps]
        result.append(Unit("settled", merged))
    return result


def section(config: StaticMapsConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    table = Table(
        "static_maps",
        "Static maps: convexity is the share of second differences of the smoothed map that are "
        "≥ 0, rank correlation is Spearman's of r with |θ − θ*|",
        (
            Column("map", "map"),
            Column("convexity", "convexity [%]", ".0f"),
            Column("rank_correlation", "rank correlation", ".3f"),
            Column("argmin", "θ at the minimum", ".2f"),
            Column("minimum", "r there", ".3g"),
        ),
    )
    panels = []
    each = len(config.ramps) + 1
    theta = maps.grid()
    for i, cost in enumerate(config.costs):
        ramps, settled = results[i * each : i * each + each - 1], results[i * each + each - 1]
        for duration, found in zip(config.ramps, ramps, strict=True):
            table.rows.append(_row(f"{cost}, ramp of {duration:g} s", np.array(found["binned"])))
        table.rows.append(_row(f"{cost}, settled", np.array(settled["mean"])))
        panels.append(_ramp_panel(cost, config.ramps[0], ramps[0]))
        panels.append(
            Panel(
                "θ",
                "r",
                (
                    Series(
                        "10–90 % over the drift", theta.tolist(), settled["low"], "band",
                        settled["high"], i,
                    ),
                    Series("mean", theta.tolist(), settled["mean"], "line", color=i),
                ),
                f"{cost}, settled",
                log_y=True,
            )
        )  # fmt: skip
    figure = Figure(
        "static_maps",
        "Static maps r(θ). Left: along the ramp from 2 down to −5, as in the paper. Right: settled "
        "at fixed θ, mean over one period of the damping drift. Logarithmic: r falls by decades.",
        tuple(panels),
        2,
    )
    return Section(
        "static_maps",
        "Static maps",
        "The cost as a function of a constant or slowly falling θ, at the default constants.",
        [table],
        [figure],
    )


def _row(name: str, r: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[Cell, ...]:
    shape = maps.shape(maps.grid(), r, THETA_STAR)
    return (name, 100.0 * shape.convexity, shape.rank_correlation, shape.argmin, shape.minimum)


def _ramp_panel(cost: str, duration: float, found: dict[str, Any]) -> Panel:
    return Panel(
        "θ",
        "r",
        (
            Series("ramp", found["theta"], found["low"], "band", found["high"], 2),
            Series("mean in bins", maps.grid().tolist(), found["binned"], "line", color=3),
        ),
        f"{cost}, ramp of {duration:g} s",
        log_y=True,
    )
