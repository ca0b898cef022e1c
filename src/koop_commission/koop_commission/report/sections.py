"""The parts of the page: each stage with its tables and figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from koop_bag.errors import BagError
from koop_commission.fitness.recording import check_recording
from koop_commission.report import recordings, spectra
from koop_commission.report.gathered import Gathered
from koop_commission.report.runs import Measured, measured
from koop_commission.report.verdict import excited_map, told
from koop_core.config.parameter import spec_of
from koop_tune.excitation.features import Bands
from koop_tune.rig.rig_file import RigFile, as_values
from koop_tune.rig_model.dwells import SHORTEST, spectra_by_theta
from koop_view.report.document import Cell, Column, Figure, Mark, Panel, Section, Series, Table

SEEN, BEST, NOISE, OTHER = 0, 2, 1, 3  # colours: what was seen, the best theta, interference
TWO = 2.0  # standard errors that are drawn
LONGEST = 3.0  # error bar, of a logarithm: where theta was once, nothing is known of the error


def sections(g: Gathered) -> Iterator[Section]:
    """Yield all parts in order; what is missing says so."""
    yield rig(g)
    yield static_map(g)
    yield spectrum(g)
    if g.tuned:
        yield costs(g)
    if g.found or g.rounds:
        yield loop(g)
        yield constants(g)
    yield Section(
        "recordings", "Recordings", "Every recording of this commissioning. States come a few "
        "seconds before theta is first commanded: those have none.",
        tables=[recordings.table(g)],
    )  # fmt: skip


def rig(g: Gathered) -> Section:
    """Return what is measured and moved, and what the check finds in the first recording."""
    meanings = {item.name: spec_of(item) for item in fields(RigFile)}
    rows: list[tuple[Cell, ...]] = [
        (name, _text(value), meanings[name].unit, meanings[name].description)
        for name, value in as_values(g.rig).items()
    ]
    columns = tuple(Column(name, name, words=True) for name in ("key", "value", "unit", "meaning"))
    tables = [Table("rig", "The rig file", columns, rows, detail=True)]
    intro = "What the check finds in the first recording:"
    if not g.bags:
        intro = "Nothing is recorded yet."
    else:
        try:
            found: list[tuple[Cell, ...]] = list(check_recording(g.rig, g.bags[0]))
            columns = tuple(Column(name, name, words=True) for name in ("level", "of", "found"))
            tables.insert(0, Table("check", "koop check", columns, found))
        except (BagError, ValueError) as error:
            intro = f"The first recording cannot be checked: {error}"
    return Section("rig-section", "Rig and check", intro, tables)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def static_map(g: Gathered) -> Section:
    """Return the static map of the amplitude, with the best theta."""
    title = "Amplitude against theta"
    if g.tuned:
        found, feature = g.tuned["static_map"], g.tuned["feature"]
        theta, level, error = found["theta"], found["amplitude"], found["error"]
        series = _stays(theta, found["visits"], OTHER)
        curve = found["curve"]
        series.append(Series("through all", curve["theta"], curve["amplitude"], color=SEEN))
        marks: tuple[Mark, ...] = ()
        if g.found:
            low, high = g.tuned["theta_best_band"]
            best = g.tuned["theta_best"]
            marks = (Mark(best, f"best {best:.3g}", low, high, BEST),)
        elif g.tuned["verdict"] == "monotone":
            limits = (g.rig.theta_min, g.rig.theta_max)
            best = min(limits, key=lambda limit: abs(limit - g.tuned["theta_best"]))
            marks = (Mark(best, f"limit {best:.3g}: best here", color=NOISE),)
    else:
        known = excited_map(g)
        if known is None:
            return Section("map", title, "No value of theta was reached yet.")
        (feature, theta, level, error), series, marks = known, [], ()
    series.append(_bars("two standard errors", theta, level, error, SEEN))
    panel = Panel(
        "theta", f"amplitude of {feature}", tuple(series), log_x=g.scale.logarithmic, marks=marks
    )
    intro = (
        "Where the rig settled at each value of theta: each stay, their mean with two standard "
        "errors, and the smoothest curve that fits."
    )
    if g.found:
        intro += (
            " Nine of ten maps drawn from the stays have their best theta in the shaded band; "
            "between two values it is where a parabola through three of them is least."
        )
    if g.refused:
        intro += f" Refused ({g.tuned['verdict']}): {g.tuned['why']}."
    figure = Figure("map", f"Static map of the amplitude of {feature}", (panel,))
    rows: list[tuple[Cell, ...]] = list(zip(theta, level, [100.0 * e for e in error], strict=True))
    columns = (Column("theta", "theta"), Column("amplitude", "amplitude"),
               Column("error", "standard error [%]", ".2g"))  # fmt: skip
    table = Table("map", "The same in numbers", columns, rows, detail=True)
    return Section("map-section", title, intro, [table], [figure])


def _stays(theta: Sequence[float], visits: Sequence[Sequence[float]], color: int) -> list[Series]:
    """Return what each stay gave: the first ones of all values, the second ones, and so on."""
    most = max(map(len, visits))
    return [
        Series(
            "each stay",
            [t for t, own in zip(theta, visits, strict=True) if len(own) > k],
            [own[k] for own in visits if len(own) > k],
            "points",
            color=color,
        )
        for k in range(most)
    ]


def _bars(
    name: str, theta: Sequence[float], level: Sequence[float], error: Sequence[float], color: int
) -> Series:
    """Return error bars; ``error`` is that of the logarithm."""
    wide = [math.exp(min(TWO * e, LONGEST)) for e in error]
    low = [y / w for y, w in zip(level, wide, strict=True)]
    high = [y * w for y, w in zip(level, wide, strict=True)]
    return Series(name, theta, low, "bars", high, color)


def spectrum(g: Gathered) -> Section:
    """Return the spectra of the channels, with what theta does not change marked."""
    title, name = "Spectra", "spectra"
    if g.loaded is None:
        return Section(name, title, f"None: {g.problem}.")
    try:
        length = g.windows.length if g.windows else SHORTEST
        found = spectra_by_theta(g.loaded, g.scale, g.rig.dt, length, 1)
    except ValueError as error:
        return Section(name, title, f"None: {error}.")
    frequency, starts = found.frequency, spectra.groups(found.frequency)
    total = found.power.sum(axis=(1, 2))
    quiet, loud = int(np.argmin(total)), int(np.argmax(total))
    theta = g.scale.theta(found.u)
    panels: list[Panel] = []
    rows: list[tuple[Cell, ...]] = []
    at = list(map(float, frequency[starts]))
    for i, channel in enumerate(g.rig.names):
        power = found.density[:, i]
        series = [
            Series("all values of theta", at, spectra.least(power.min(axis=0), starts), "band",
                   spectra.largest(power.max(axis=0), starts), OTHER + 4),
            Series(f"theta {theta[loud]:.3g}", at, spectra.largest(power[loud], starts),
                   color=SEEN),
            Series(f"theta {theta[quiet]:.3g}", at, spectra.largest(power[quiet], starts),
                   color=BEST),
        ]  # fmt: skip
        marks = []
        for peak in spectra.lines_of(found, i):
            what = "oscillation" if peak.moved else "interference"
            marks.append(Mark(peak.line.frequency, f"{what} {peak.line.frequency:.3g} Hz",
                              color=SEEN if peak.moved else NOISE))  # fmt: skip
            rows.append((channel, peak.line.frequency, what, peak.least, peak.most))
        panels.append(
            Panel("frequency [Hz]", "density [1/Hz]", tuple(series), channel, True, True,
                  marks=tuple(sorted(marks, key=lambda mark: mark.x)))
        )  # fmt: skip
    columns = (Column("channel", "channel"), Column("frequency", "frequency [Hz]", ".3g"),
               Column("what", "what", words=True), Column("least", "least amplitude", ".3g"),
               Column("most", "largest amplitude", ".3g"))  # fmt: skip
    intro = (
        "Each channel where theta rested: all values, that of the strongest and that of the "
        "weakest motion. A narrow line that theta does not change is marked as interference."
    )
    table = Table(name, "Narrow lines, over all values of theta", columns, rows)
    figure = Figure("spectra-figure", "Spectral density of each channel", tuple(panels),
                    columns=min(len(panels), 2))  # fmt: skip
    return Section(name, title, intro, [table], [figure])


def costs(g: Gathered) -> Section:
    """Return r against theta for every candidate, and how they compare."""
    title = "Costs"
    every = g.tuned["costs"]
    if not every:
        return Section(
            "costs", title, "None was tried: the amplitude itself shows no optimum to seek."
        )
    panels: list[Panel] = []
    rows: list[tuple[Cell, ...]] = []
    for cost in every:
        found = cost["map"]
        best = found["theta_best"] if found else None
        rows.append((cost["name"], best, cost["evidence"], cost["score"], cost["problem"] or ""))
        if not found:
            continue
        theta, r = found["theta"], found["r"]
        chosen = cost["name"] == g.tuned.get("cost")
        color = SEEN if chosen else OTHER
        marks = () if best is None else (Mark(best, f"least {best:.3g}", color=BEST),)
        series = (
            *_stays(theta, found["visits"], OTHER + 4),
            Series("mean", theta, r, color=color),
            _bars("two standard errors", theta, r, found["error"], color),
        )
        panels.append(
            Panel("theta", "r", series, cost["name"] + (" (chosen)" if chosen else ""),
                  g.scale.logarithmic, True, marks=marks)
        )  # fmt: skip
    columns = (Column("cost", "cost"), Column("best", "best at theta"),
               Column("evidence", "evidence (Δχ²)", ".0f"), Column("score", "score", ".3g"),
               Column("problem", "why not", words=True))  # fmt: skip
    intro = "What the controller would see: r where the rig settled at each value of theta."
    if g.found:
        intro += f" Chosen: {g.tuned['cost']}. {g.tuned['why'][0].upper()}{g.tuned['why'][1:]}."
    else:
        intro += f" {g.tuned['why'][0].upper()}{g.tuned['why'][1:]}."
    table = Table(
        "costs",
        "Candidates; evidence: by how much a valley fits better than a slope, in chi-squared; "
        "score: 1 is perfect",
        columns,
        rows,
    )
    figure = Figure("costs-figure", "r against theta", tuple(panels), columns=2)
    return Section("costs", title, intro, [table], [figure] if panels else [])


def loop(g: Gathered) -> Section:
    """Return the closed loop: predicted, and measured where it was."""
    title = "Closed loop, predicted and measured"
    if not g.rounds:
        intro = (
            "Predicted, from both ends of the range: median and 5 to 95 % of the runs. Nothing "
            f"is measured yet: ./koop verify {g.file} {g.folder}"
        )
        figures = [
            _run_figure(g, f"predicted-{i}", f"From theta = {path['start']:.4g}", g.tuned, path)
            for i, path in enumerate(g.tuned["paths"])
        ]
        return Section("loop", title, intro, [_predicted(g)], figures)
    intro = (
        "Predicted (median and 5 to 95 % of the runs from the nearer end of the range) and "
        "measured on the rig, each run from its own start."
    )
    figures = []
    for one in g.rounds:
        number, tuned = one["round"], g.tuned_for(one["round"])
        for k, run in enumerate(one["runs"]):
            caption = f"Round {number}, from theta = {run['start']:.4g}"
            try:
                found = _measured(g, tuned, run)
            except (BagError, ValueError, OSError) as error:
                caption, found = f"{caption}: not drawn: {error}", None
            path = _nearest(g, tuned["paths"], run["start"])
            figures.append(_run_figure(g, f"run-{number}-{k}", caption, tuned, path, found))
    return Section("loop", title, intro, [_compared(g)], figures)


def _measured(g: Gathered, tuned: dict[str, Any], run: dict[str, Any]) -> Measured:
    windows = tuned["windows"]
    how = Bands(windows["length"], tuple(windows["edges"]), windows["dt"])
    steps = run.get("closed", {}).get("steps")
    return measured(g.folder / run["bag"], g.rig.dt, how, windows["feature"], steps)


def _nearest(g: Gathered, paths: Sequence[dict[str, Any]], start: float) -> dict[str, Any]:
    """Return the predicted path that begins nearest."""
    u = g.scale.u(np.array([start, *(path["start"] for path in paths)]))
    return paths[int(np.argmin(np.abs(u[1:] - u[0])))]


def _run_figure(
    g: Gathered, name: str, caption: str, tuned: dict[str, Any], path: dict[str, Any],
    found: Measured | None = None,
) -> Figure:  # fmt: skip
    theta: list[Series] = []
    amplitude: list[Series] = []
    t = path["time"]
    ends = [t[0], t[-1]]
    for series, of in ((theta, path["theta"]), (amplitude, path["amplitude"])):
        series.append(Series("predicted", t, of["low"], "band", of["high"], BEST))
        series.append(Series("predicted", t, of["middle"], color=BEST))
    if found is not None:
        ends = [0.0, max(t[-1], float(found.time[-1]))]
        for series, x, y in ((theta, found.time, found.theta),
                             (amplitude, found.at, found.amplitude)):  # fmt: skip
            series.append(Series("measured", x.tolist(), y.tolist(), color=SEEN))
    curve = tuned["static_map"]["curve"]["amplitude"]
    best = min(curve) if g.rig.objective == "minimise" else max(curve)
    theta.append(Series("best theta", ends, [tuned["theta_best"]] * 2, "level"))
    amplitude.append(Series("best amplitude", ends, [best] * 2, "level"))
    panels = (
        Panel("time [s]", "theta", tuple(theta), log_y=g.scale.logarithmic),
        Panel("time [s]", f"amplitude of {tuned['feature']}", tuple(amplitude)),
    )
    return Figure(name, caption, panels, columns=2)


def _predicted(g: Gathered) -> Table:
    p = g.tuned["predicted"]
    rows: list[tuple[Cell, ...]] = [
        ("time to converge [s]", told(p["converges"])),
        ("mean distance of theta from the best, of its range", told(p["distance"])),
        ("amplitude over the best one", told(p["excess"])),
        ("amplitude at the start over that", told(p["reduction"])),
    ]
    columns = (Column("figure", "predicted"), Column("value", "median (5 to 95 %)"))
    return Table("predicted", f"{p['runs']} runs of {p['duration']:.4g} s", columns, rows)


def _compared(g: Gathered) -> Table:
    names = ("time_to_converge", "distance", "amplitude_before", "amplitude", "excess",
             "reduction", "theta", "swing")  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for one in g.rounds:
        p = one["prediction"]
        told_of = {
            "time_to_converge": told(p["converges"]), "distance": told(p["distance"]),
            "excess": told(p["excess"]), "reduction": told(p["reduction"]),
        }  # fmt: skip
        rows.append((f"round {one['round']}: predicted", None, *map(told_of.get, names)))
        for run in one["runs"]:
            took = run["time_to_converge"]
            measured_of = {**run, "time_to_converge": "never" if took is None else took}
            rows.append(("measured", run["start"], *map(measured_of.get, names)))
    columns = (
        Column("what", ""), Column("start", "from theta"),
        Column("time_to_converge", "converged after [s]", ".3g"),
        Column("distance", "distance from the best theta, of the range", ".3g"),
        Column("amplitude_before", "amplitude before", ".3g"),
        Column("amplitude", "amplitude after", ".3g"),
        Column("excess", "over the best one", ".3g"), Column("reduction", "by a factor of", ".3g"),
        Column("theta", "theta at the end", ".4g"), Column("swing", "its swing", ".3g"),
    )  # fmt: skip
    said = [f"round {one['round']}: {one['says']}" for one in g.rounds if one["says"]]
    return Table("compared", "; ".join(said) or "Predicted and measured", columns, rows)


def constants(g: Gathered) -> Section:
    """Return every constant with its reason."""
    rows: list[tuple[Cell, ...]] = [
        (item["name"], _text(item["value"]), item["unit"], item["reason"], item["node"])
        for item in g.tuned.get("parameters", [])
    ]
    columns = tuple(
        Column(name, name, words=name in ("unit", "reason", "node"))
        for name in ("parameter", "value", "unit", "reason", "node")
    )
    table = Table(
        "constants", "controller.yaml, without what is left at its default", columns, rows
    )
    return Section("constants-section", "Constants and their reasons",
                   "What the loop runs with, and why.", [table])  # fmt: skip
