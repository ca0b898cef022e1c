"""The closed loop of a commissioning, predicted and measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from koop_bag.errors import BagError
from koop_commission.report.contents import Contents
from koop_commission.report.drawing import BEST, MEASURED
from koop_commission.report.runs import RunCurves, read_run
from koop_core.errors import InputError
from koop_tune.result.tune_result import Curves, LoopPath, TuneResult
from koop_tune.search.agreement import name_gains, spell
from koop_tune.search.rounds import Round
from koop_view.report.document import Cell, Column, Figure, Panel, Section, Series, Table

TITLE = "Closed loop, predicted and measured"
COMPARED = (
    Column("what", ""),
    Column("start", "from theta"),
    Column("time_to_converge", "converged within [s]", ".3g"),
    Column("distance", "distance from the best theta, of the range", ".3g"),
    Column("amplitude_before", "amplitude before", ".3g"),
    Column("amplitude", "amplitude after", ".3g"),
    Column("excess", "", ".3g"),
    Column("reduction", "", ".3g"),
    Column("theta", "mean of theta", ".4g"),
    Column("swing", "its swing", ".3g"),
)


def make_loop(c: Contents) -> Section:
    """Return the closed loop: predicted, and measured where it was."""
    figures = []
    if not c.verification.rounds:
        fit, controller = c.tuned.require_controller()
        for i, path in enumerate(controller.paths):
            caption = f"From theta = {path.start:.4g}"
            figures.append(_draw(c, f"predicted-{i}", caption, c.tuned, path))
        intro = (
            "Predicted, from both ends of the range: median and 5 to 95 % of the runs. Not "
            f"measured yet: ./koop verify {c.rig_file} {c.folder}"
        )
        table = _compare([Round(1, controller.predicted)], c.rig.sense)
        return Section("loop", TITLE, intro, [table], figures)
    for item in c.verification.rounds:
        tuned = c.tuned_for(item)
        fit, controller = tuned.require_controller()
        for i, run in enumerate(item.runs):
            caption, recorded = f"Round {item.number}, from theta = {spell(run.start)}", None
            try:
                recorded = read_run(c.folder / run.bag, fit.amplitude, run.steps)
            except (BagError, InputError) as error:
                caption = f"{caption}: not drawn: {error}"
            nearest = None
            if paths := controller.paths:  # of one knob
                u = c.rig.scale.u(np.array([run.start[0], *(path.start for path in paths)]))
                nearest = paths[int(np.argmin(np.abs(u[1:] - u[0])))]
            figures.append(_draw(c, f"run-{item.number}-{i}", caption, tuned, nearest, recorded))
    tables = [_compare(c.verification.rounds, c.rig.sense)]
    predicted = "Predicted (median and 5 to 95 % of the runs from the nearer end of the range) and "
    measured = "measured on the rig, each run from its own start."
    intro = predicted + measured if c.rig.count == 1 else measured.capitalize()
    return Section("loop", TITLE, intro, tables, figures)


def _draw(
    c: Contents, name: str, caption: str, tuned: TuneResult, path: LoopPath | None,
    run: RunCurves | None = None,
) -> Figure:  # fmt: skip
    time = path.time if path else []
    ends = [*time[:1], *time[-1:]]
    if run:
        ends = [0.0, max([float(run.time[-1]), *time[-1:]])]
    fit, _ = tuned.require_controller()
    best = (min if c.rig.objective == "minimise" else max)(fit.curve.level)

    def make_series(
        band: Curves | None, what: str, level: float | None, measured: tuple[Any, Any] | None
    ) -> tuple[Series, ...]:
        series = []
        if band is not None:
            series.append(Series("predicted", time, band.low, "band", band.high, BEST))
            series.append(Series("predicted", time, band.middle, color=BEST))
        if measured is not None:
            x, y = measured
            series.append(Series("measured", x.tolist(), y.tolist(), color=MEASURED))
        if level is not None:
            series.append(Series(f"best {what}", ends, [level] * len(ends), "level"))
        return tuple(series)

    panels = []
    for knob, (what, scale) in enumerate(zip(c.rig.knob_names, c.rig.scales, strict=True)):
        at = tuned.maps[knob].theta_best if knob in tuned.maps else None
        theta = (run.time, run.theta[knob]) if run else None
        series = make_series(path.theta if path else None, what, at, theta)
        panels.append(Panel("time [s]", what, series, log_y=scale.logarithmic))
    amplitude = (run.middle, run.amplitude) if run else None
    series = make_series(path.amplitude if path else None, "amplitude", best, amplitude)
    panels.append(Panel("time [s]", "amplitude", series, log_y=True))
    return Figure(name, caption, tuple(panels), columns=2)


def _compare(rounds: Sequence[Round], sense: float) -> Table:
    names = [column.key for column in COMPARED[2:]]
    rows: list[tuple[Cell, ...]] = []
    for item in rounds:
        p = item.prediction
        bands = {"time_to_converge": p.converges, "distance": p.distance, "excess": p.excess,
                 "reduction": p.reduction}  # fmt: skip
        cells = (bands[name].as_text() if name in bands else None for name in names)
        rows.append((f"round {item.number}: predicted", None, *cells))
        for run in item.runs:
            values = [getattr(run.measured, name) for name in names]
            rows.append(("measured", *map(_make_cell, (run.start, *values))))
    summaries = [f"round {r.number}: {r.summary}" for r in rounds if r.summary]
    gains = dict(zip(("excess", "reduction"), name_gains(sense), strict=True))
    columns = tuple(replace(c, title=gains.get(c.key, c.title)) for c in COMPARED)
    return Table("compared", "; ".join(summaries) or "Predicted and measured", columns, rows)


def _make_cell(value: float | tuple[float, ...] | None) -> Cell:
    """Return a figure, or that of each knob."""
    if isinstance(value, tuple):
        return value[0] if len(value) == 1 else spell(value)
    return "never" if value is None else value
