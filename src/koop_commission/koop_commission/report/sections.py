"""The sections of the page: rig, static map, costs, constants; the others have their own files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

from koop_bag.errors import BagError
from koop_commission.fitness.recording import check_recording
from koop_commission.report.colors import BEST, FAINT, INTERFERENCE, MEASURED, OTHER
from koop_commission.report.contents import Contents
from koop_commission.report.loop import make_loop
from koop_commission.report.recordings import make_recordings
from koop_commission.report.spectra import make_spectra
from koop_core.config.parameter import spec_of
from koop_core.errors import InputError
from koop_tune.rig.rig_file import RigFile, as_values
from koop_view.report.document import Cell, Column, Figure, Mark, Panel, Section, Series, Table

ERRORS = 2.0  # standard errors that are drawn
LONGEST = 3.0  # error bar, of a logarithm: of a value that theta had once, no error is known
Rows = list[tuple[Cell, ...]]


def make_sections(c: Contents) -> Iterator[Section]:
    """Yield all sections in order; each says what is missing."""
    yield make_rig(c)
    yield make_static_map(c)
    yield make_spectra(c)
    if c.tuned:
        yield make_costs(c)
    if c.has_controller or c.verification.rounds:
        yield make_loop(c)
        yield make_constants(c)
    yield make_recordings(c)


def make_rig(c: Contents) -> Section:
    """Return the rig file, and the findings of the check in the first recording."""
    specs = {item.name: spec_of(item) for item in fields(RigFile)}
    rows: Rows = [
        (name, _format(value), specs[name].unit, specs[name].description)
        for name, value in as_values(c.rig).items()
    ]
    tables = [Table("rig", "The rig file", _words("key", "value", "unit", "meaning"), rows, True)]
    intro = "Findings of 'koop check' in the first recording:"
    if not c.bags:
        intro = "No recording yet."
    else:
        try:
            findings: Rows = list(check_recording(c.rig, c.bags[0]))
            columns = _words("level", "name", "finding")
            tables.insert(0, Table("check", "koop check", columns, findings))
        except (BagError, InputError) as error:
            intro = f"The first recording cannot be checked: {error}"
    return Section("rig-section", "Rig and check", intro, tables)


def make_static_map(c: Contents) -> Section:
    """Return the static map of the amplitude, with the best theta."""
    title, static = "Amplitude against theta", c.static_map
    if static is None:
        return Section("map", title, "theta was at no dwell point yet.")
    series: list[Series] = []
    marks: tuple[Mark, ...] = ()
    intro = (
        "The amplitude to which the rig settled at each value of theta: each visit, their mean "
        "with two standard errors, and the smoothest curve that fits."
    )
    if c.tuned:
        figures, best = c.tuned["static_map"], c.tuned["theta_best"]
        curve = figures["curve"]
        series += _scatter(figures["theta"], figures["visits"], OTHER)
        series.append(Series("fit", curve["theta"], curve["amplitude"], color=MEASURED))
        if c.has_controller:
            low, high = c.tuned["theta_best_band"]
            marks = (Mark(best, f"best {best:.3g}", low, high, BEST),)
            intro += (
                " Nine of ten maps drawn from the visits have their best theta in the shaded band;"
                " between two values it is the vertex of a parabola through three of them."
            )
        elif c.tuned["verdict"] == "monotone":
            limit = min((c.rig.theta_min, c.rig.theta_max), key=lambda limit: abs(limit - best))
            marks = (Mark(limit, f"limit {limit:.3g}: best here", color=INTERFERENCE),)
        if c.is_refused:
            intro += f" Refused ({c.tuned['verdict']}): {c.tuned['why']}."
    series.append(_bars(static.theta, static.amplitude, static.error, MEASURED))
    caption = f"amplitude of {static.feature}"
    panel = Panel("theta", caption, tuple(series), log_x=c.rig.scale.logarithmic, marks=marks)
    columns = (
        Column("theta", "theta"),
        Column("amplitude", "amplitude"),
        Column("error", "standard error [%]", ".2g"),
    )
    errors = [100.0 * error for error in static.error]
    rows: Rows = list(zip(static.theta, static.amplitude, errors, strict=True))
    table = Table("map", "The same in numbers", columns, rows, detail=True)
    figure = Figure("map", f"Static map of the {caption}", (panel,))
    return Section("map-section", title, intro, [table], [figure])


def make_costs(c: Contents) -> Section:
    """Return r against theta for every candidate, and how they compare."""
    candidates = c.tuned["costs"]
    if not candidates:
        intro = "None was tried: the amplitude itself shows no optimum to seek."
        return Section("costs", "Costs", intro)
    panels: list[Panel] = []
    rows: Rows = []
    for cost in candidates:
        figures, chosen = cost["map"], cost["name"] == c.tuned.get("cost")
        best = figures["theta_best"] if figures else None
        rows.append((cost["name"], best, cost["evidence"], cost["score"], cost["problem"] or ""))
        if not figures:
            continue
        theta, r, color = figures["theta"], figures["r"], MEASURED if chosen else OTHER
        series = (
            *_scatter(theta, figures["visits"], FAINT),
            Series("mean", theta, r, color=color),
            _bars(theta, r, figures["error"], color),
        )
        marks = () if best is None else (Mark(best, f"least {best:.3g}", color=BEST),)
        title = cost["name"] + " (chosen)" * chosen
        panels.append(
            Panel("theta", "r", series, title, c.rig.scale.logarithmic, log_y=True, marks=marks)
        )
    why = f"{c.tuned['why'][0].upper()}{c.tuned['why'][1:]}."
    chosen_words = f" Chosen: {c.tuned['cost']}." if c.has_controller else ""
    intro = f"The cost r to which the rig settled at each value of theta.{chosen_words} {why}"
    columns = (
        Column("cost", "cost"),
        Column("best", "best at theta"),
        Column("evidence", "evidence (Δχ²)", ".0f"),
        Column("score", "score", ".3g"),
        Column("problem", "problem", words=True),
    )
    title = (
        "Candidates. Evidence: by how much curves without an interior optimum fit worse; score: 1 "
        "is perfect"
    )
    figure = Figure("costs-figure", "r against theta", tuple(panels), columns=2)
    table = Table("costs", title, columns, rows)
    return Section("costs", "Costs", intro, [table], [figure] if panels else [])


def make_constants(c: Contents) -> Section:
    """Return every constant with its reason."""
    keys = ("name", "value", "unit", "reason", "node")
    rows: Rows = [
        tuple(_format(item[key]) for key in keys) for item in c.tuned.get("parameters", [])
    ]
    numbers = (Column("parameter", "parameter"), Column("value", "value"))
    columns = (*numbers, *_words("unit", "reason", "node"))
    table = Table("constants", "controller.yaml, without defaults", columns, rows)
    intro = "The constants of the loop, and the reason for each."
    return Section("constants-section", "Constants and their reasons", intro, [table])


def _format(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_format, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _words(*names: str) -> tuple[Column, ...]:
    return tuple(Column(name, name, words=True) for name in names)


def _scatter(theta: Sequence[float], visits: Sequence[Sequence[float]], color: int) -> list[Series]:
    """Return the visits as points: the first ones of all values, the second ones, and so on."""
    series = []
    for k in range(max(map(len, visits))):
        pairs = [(t, y[k]) for t, y in zip(theta, visits, strict=True) if len(y) > k]
        x, y = (list(column) for column in zip(*pairs, strict=True))
        series.append(Series("each visit", x, y, "points", color=color))
    return series


def _bars(
    theta: Sequence[float], level: Sequence[float], error: Sequence[float], color: int
) -> Series:
    """Return error bars; ``error`` is the standard error of the logarithm."""
    factors = [math.exp(min(ERRORS * e, LONGEST)) for e in error]
    low = [y / factor for y, factor in zip(level, factors, strict=True)]
    high = [y * factor for y, factor in zip(level, factors, strict=True)]
    return Series("two standard errors", theta, low, "bars", high, color)
