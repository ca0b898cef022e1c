"""Experiment ``static_maps``: r(theta) along ramps and settled, and how convex it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_study.simulation import maps
from koop_study.workers.units import Unit
from koop_view.report.document import Column, Figure, Panel, Section, Series, Table
from vdp_plant.config import PlantConfig

SHARED = "esc.theta_initial"  # must be the plant's
COLUMNS = (
    Column("map", "map"),
    Column("convexity", "convexity [%]", ".0f"),
    Column("rank_correlation", "rank correlation", ".3f"),
    Column("argmin", "θ at the minimum", ".2f"),
    Column("minimum", "r there", ".3g"),
)


@dataclass(frozen=True)
class StaticMapsConfig:
    """Costs, each with settings of its own, and durations of the ramp [s]."""

    costs: dict[str, dict[str, Any]]
    ramps: tuple[float, ...]
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.ramps and all(1.0 <= duration <= 1e6 for duration in self.ramps)):
            raise ConfigError(f"ramps = {list(self.ramps)}: needs at least one, of 1 to 1e6 s")
        for name in [name for some in (self.settings, *self.costs.values()) for name in some]:
            if name == "duration" or (name.startswith("esc.") and name != SHARED):
                raise ConfigError(f"{name}: has no effect on a static map, nor has the controller")

    def maps(self) -> list[tuple[str, float, dict[str, Any]]]:
        """Return cost, duration of the ramp, or 0 for the settled map, and settings."""
        return [
            (cost, duration, {**self.settings, **settings})
            for cost, settings in self.costs.items()
            for duration in (*self.ramps, 0.0)
        ]


def units(config: StaticMapsConfig) -> list[Unit]:
    """Return one unit a map."""
    return [
        Unit("ramp", {"settings": settings, "duration": duration})
        if duration
        else Unit("settled", {"settings": settings})
        for _, duration, settings in config.maps()
    ]


def section(config: StaticMapsConfig, results: list[Any]) -> Section:
    """Return the part of the report."""
    title = (
        "Static maps: convexity is the share of second differences of the smoothed map that are "
        "≥ 0, rank correlation is Spearman's of r with |θ − θ*|"
    )
    table, panels = Table("static_maps", title, COLUMNS), []
    for (cost, duration, _), result in zip(config.maps(), results, strict=True):
        name = f"{cost}, ramp of {duration:g} s" if duration else f"{cost}, settled"
        shape = maps.shape(maps.grid(), np.array(result["mean"]), PlantConfig.theta_star)
        table.rows.append((name, 100.0 * shape[0], *shape[1:]))
        if duration in (config.ramps[0], 0.0):
            series = (
                Series("range", result["theta"], result["low"], "band",
                       result["high"], 0),
                Series("mean", maps.grid().tolist(), result["mean"], "line", color=0),
            )  # fmt: skip
            panels.append(Panel("θ", "r", series, name, log_y=True))
    caption = (
        "Static maps r(θ). Left: along the ramp from 2 down to −5, as in the paper; the band is "
        "all of r. Right: settled at fixed θ, over one period of the damping drift. Logarithmic: "
        "r falls by decades."
    )
    text = "The cost as a function of a constant or slowly falling θ, at the default constants."
    figure = Figure("static_maps", caption, tuple(panels), 2)
    return Section("static_maps", "Static maps", text, [table], [figure])
