"""The sections of the page: rig, static map, costs, constants; the others have their own files."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from koop_bag.errors import BagError
from koop_commission.fitness.recording import check_recording
from koop_commission.report.contents import Contents
from koop_commission.report.drawing import (
    BEST,
    FAINT,
    INTERFERENCE,
    MEASURED,
    OTHER,
    step_apart,
)
from koop_commission.report.loop import make_loop
from koop_commission.report.pairs import draw_pairs
from koop_commission.report.spectra import make_spectra
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import spec_of
from koop_core.errors import InputError
from koop_tune.excitation.holds import spell_error
from koop_tune.excitation.static_map import MAP, times_best
from koop_tune.result.tune_result import Points
from koop_tune.rig.rig_file import RigFile, as_values
from koop_view.report.document import Cell, Column, Figure, Mark, Panel, Section, Series, Table

ERRORS = 2.0  # standard errors that are drawn
LARGEST = 1.0  # error of a logarithm that is known; a hold that was cut short tells none
Rows = list[tuple[Cell, ...]]


def make_sections(c: Contents) -> Iterator[Section]:
    """Yield all sections in order; each says what is missing."""
    yield make_rig(c)
    yield make_static_map(c)
    if c.rig.count == 1:
        yield make_spectra(c)
    if c.tuned.verdict:
        yield make_costs(c)
    if c.tuned.controller or c.verification.rounds:
        yield make_loop(c)
        yield make_constants(c)


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
    """Return the static map of the amplitude over each knob, with the best theta."""
    title, several = "Amplitude against theta", c.rig.count > 1
    intro = (
        "The amplitude to which the rig settled at each hold of theta, with two standard errors "
        "where they are known, in units of each channel's strongest motion. Curve and band: the "
        "map that fits, within two standard errors; where the band is wide nobody has looked."
    )
    if several:
        intro += " Each knob alone is moved through the best of all, where the others stay."
    if fit := c.tuned.static_map:
        if c.tuned.controller:
            most = "most" if c.rig.sense > 0.0 else "least"
            intro += (
                f" Shaded: the valley, where the amplitude is at {most} "
                f"{times_best(MAP.good, c.rig.sense)}, which is "
                f"{math.exp(fit.best):.3g}; below {fit.amplitude.floor:.2g} nothing can be "
                "resolved."
            )
            if fit.shares:
                parts = "; ".join(fit.shares)
                intro += f" Shares in the amplitude's square over theta: {parts}."
        intro += f" Note: {fit.moved}." * bool(fit.moved)
    if c.tuned.is_refused:
        intro += f" Refused ({c.tuned.verdict}): {c.tuned.why}."
    panels = tuple(_draw_map(c, knob, static) for knob, static in c.holds_by_knob.items())
    tables: list[Table] = []
    figures: list[Figure] = []
    if panels:
        caption = f"Static map of the amplitude of {c.feature}"
        figures.append(Figure("map", caption, panels, columns=min(len(panels), 2)))
    if several and c.tuned.controller:
        tables.insert(0, _list_worth(c))
    if len(pairs := c.excitation.sections) > 1:
        figures.append(draw_pairs(c, [line.knob for line in pairs]))
    if c.excitation.holds:
        tables.append(_list_holds(c))
    if not figures and not tables:
        return Section("map", title, "theta was at no dwell point yet.")
    return Section("map-section", title, intro, tables, figures)


def _draw_map(c: Contents, knob: int, static: Points) -> Panel:
    """Return the map over a knob: holds, and the curve that fits."""
    series: list[Series] = []
    marks: tuple[Mark, ...] = ()
    scale = c.rig.scales[knob]
    if fit := c.tuned.maps.get(knob):
        curve, best = fit.curve, fit.theta_best
        low, high = (
            [y * math.exp(side * ERRORS * e) for y, e in zip(curve.level, curve.error, strict=True)]
            for side in (-1.0, 1.0)
        )
        series.append(Series("map", curve.theta, low, "band", high, FAINT))
        series.append(Series("map", curve.theta, curve.level, color=MEASURED))
        if c.tuned.controller:
            marks = (Mark(best, f"best {best:.4g}", *fit.valley, BEST),)
        elif c.tuned.verdict == "monotone":
            limit = min((scale.low, scale.high), key=lambda limit: abs(limit - best))
            marks = (Mark(limit, f"limit {limit:.3g}: best here", color=INTERFERENCE),)
    series.append(_bars(static, MEASURED))
    name = c.rig.knob_names[knob]
    return Panel(name, "amplitude", tuple(series), log_x=scale.logarithmic, log_y=True, marks=marks)


def _list_worth(c: Contents) -> Table:
    """Return how much each knob matters."""
    worth = "amplitude over its range, over the best"
    if c.rig.sense < 0.0:
        worth = "best amplitude, over the least of its range"
    columns = (
        Column("knob", "knob", words=True),
        Column("best", "best at"),
        *_words("valley"),
        Column("worth", worth, ".3g"),
    )
    rows: Rows = []
    for knob, name in enumerate(c.rig.knob_names):
        if (fit := c.tuned.maps.get(knob)) is None:
            rows.append((name, None, "no effect", 1.0))
            continue
        levels = [level**c.rig.sense for level in fit.curve.level]
        valley = f"{fit.valley.low:.4g} to {fit.valley.high:.4g}"
        rows.append((name, fit.theta_best, valley, max(levels) / min(levels)))
    return Table("worth", "How much each knob matters, the others at their best", columns, rows)


def _list_holds(c: Contents) -> Table:
    """Return where theta was held, in order, and why there."""
    columns = (
        Column("hold", "hold"),
        Column("theta", "theta", words=c.rig.count > 1),
        Column("amplitude", "amplitude", ".3g"),
        Column("error", "standard error", words=True),
        Column("settled", "settled after [s]", ".3g"),
        Column("seconds", "held [s]", ".3g"),
        Column("why", "why there", words=True),
    )
    rows: Rows = [
        (k, format_knobs(h.theta, ".4g"), math.exp(h.level), spell_error(h.error), *h[3:])
        for k, h in enumerate(c.excitation.holds, 1)
    ]
    return Table("holds", "Holds of the excitation, in order", columns, rows, detail=True)


def make_costs(c: Contents) -> Section:
    """Return r against theta for every candidate, and how they compare."""
    chosen = c.tuned.controller.cost if c.tuned.controller else ""
    if not c.tuned.costs:
        intro = "None was tried: the amplitude itself shows no optimum to seek."
        return Section("costs", "Costs", intro)
    panels: list[Panel] = []
    rows: Rows = []
    knob = c.tuned.static_map.knob if c.tuned.static_map else 0
    name, scale = c.rig.knob_names[knob], c.rig.scales[knob]
    least = "least" if c.rig.sense > 0.0 else "largest"
    for cost in c.tuned.costs:
        best = cost.theta_best
        rows.append((cost.name, best, cost.evidence, cost.score, cost.problem))
        if cost.r is None:
            continue
        is_chosen = cost.name == chosen
        color = MEASURED if is_chosen else OTHER
        series = (
            Series("holds", step_apart(cost.r.theta), cost.r.level, "points", color=color),
            _bars(cost.r, color),
        )
        marks = () if best is None else (Mark(best, f"{least} {best:.3g}", color=BEST),)
        title = cost.name + " (chosen)" * is_chosen
        panels.append(Panel(name, "r", series, title, scale.logarithmic, log_y=True, marks=marks))
    why = f"{c.tuned.why[0].upper()}{c.tuned.why[1:]}."
    chosen_words = chosen and f" Chosen: {chosen}."
    intro = f"The cost r to which the rig settled at each value of theta.{chosen_words} {why}"
    columns = (
        Column("cost", "cost"),
        Column("best", "best at theta"),
        Column("evidence", "evidence (Δχ²)", ".0f"),
        Column("score", "score", ".3g"),
        Column("problem", "problem", words=True),
    )
    title = (
        "Candidates. Evidence: by how many standard errors, squared, both ends are worse; score of "
        "the search: amplitude and time to converge, also of a moving optimum; 1 is perfect"
    )
    figure = Figure("costs-figure", "r against theta", tuple(panels), columns=2)
    table = Table("costs", title, columns, rows)
    return Section("costs", "Costs", intro, [table], [figure] if panels else [])


def make_constants(c: Contents) -> Section:
    """Return every constant with its reason."""
    parameters = c.tuned.controller.parameters if c.tuned.controller else []
    rows: Rows = [tuple(map(_format, item)) for item in parameters]
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


def _bars(points: Points, color: int) -> Series:
    """Return error bars where the errors are known."""
    factors = [math.exp(ERRORS * e) if e < LARGEST else 1.0 for e in points.error]
    low = [y / factor for y, factor in zip(points.level, factors, strict=True)]
    high = [y * factor for y, factor in zip(points.level, factors, strict=True)]
    theta = step_apart(points.theta)
    return Series("hold, two standard errors", theta, low, "bars", high, color)
