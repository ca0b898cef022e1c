"""The page of ``koop report``: a loop's amplitude, theta, cost and health, and what happened."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np

from koop_core.stream.report import LEVELS
from koop_lab.history.events import (
    MOST,
    Trouble,
    faults,
    format_span,
    list_events,
    trips,
    troubles,
)
from koop_lab.history.read import History
from koop_lab.history.seconds import Floats, Rows, gather
from koop_view.report import markup
from koop_view.report.document import Cell, Column, Figure, Mark, Panel, Section, Series, Table

POINTS = 700  # of a curve
MARKS = 40  # trips that are named in the figure
HINT = (
    f"{markup.HINT} Curves are means, bands reach from the least to the largest. All times are UTC."
)
TIME = "time (UTC)"
DAY, MINUTE, SECOND = "%-d %B %Y, %H:%M", "%-d %b, %H:%M", "%a %-d %b %H:%M:%S"
EVENTS = (Column("time", "time (UTC)"), Column("what", "what happened", words=True))


def make_page(histories: Sequence[History]) -> str:
    """Return the page of the loops of some runs."""
    sections = [part for history in histories for part in _make_sections(history)]
    runs = histories[0].runs
    begin, end = runs[0].begin, max(run.end for run in runs)
    title = f"Report from {_at(begin, DAY)} to {_at(end, DAY)}"
    sentences = [text for item in histories for text in write_sentences(item)]
    verdict = markup.verdict([*sentences, *histories[0].damaged])
    return markup.page(title, [verdict, f"<p><small>{HINT}</small></p>"], sections)


def write_sentences(history: History) -> Iterator[str]:
    """Yield what a reader has to know first."""
    rows, runs, tripped, ill = history.rows, history.runs, trips(history), troubles(history)
    begin, end = runs[0].begin, max(run.end for run in runs)
    recorded = _length([(run.begin, run.end) for run in runs])
    name = f"Loop {history.name}: " if history.name else ""
    yield (
        f"{name}{format_span(recorded)} recorded in {_count(len(runs), 'run')}, "
        f"{_share(recorded, end - begin)} of the time."
    )
    for channel, amplitude in zip(history.channels, rows.amplitude.T, strict=True):
        known = amplitude[np.isfinite(amplitude)]
        if not known.size:
            continue
        tenth = max(3, known.size // 10)  # a loop that begins or ends is not how it does
        first, last = np.median(known[:tenth]), np.median(known[-tenth:])
        at = int(np.nanargmax(amplitude))
        yield (
            f"Amplitude of {channel} as measured, with any interference: {first:.3g} at first, "
            f"{last:.3g} at last (medians of a tenth of the time or more), at most "
            f"{amplitude[at]:.3g} over {rows.weight[at]:g} s ({_at(rows.time[at], MINUTE)})."
        )
    failed = faults(history)
    if failed:
        last, times = failed[-1], _count(len(failed), "time")
        yield f"The loop failed {times}, at last {_at(last.begin, SECOND)}. {last.text}"
    lost = _length([(trip.begin, trip.end) for trip in tripped])
    yield (
        f"The guard tripped {_count(len(tripped), 'time')}, and kept theta from the controller for "
        f"{format_span(lost)}."
        if tripped
        else _no_trip(history, bool(failed))
    )
    bad = _length([(trouble.begin, trouble.end) for trouble in ill])
    yield f"No node complained for {_share(recorded - bad, recorded)} of the recorded time."


def _no_trip(history: History, failed: bool) -> str:
    if not history.guard:
        return "No guard was recorded."
    return "Apart from that, the guard did not trip." if failed else "The guard did not trip."


def _make_sections(history: History) -> Iterator[Section]:
    events, name = list_events(history), history.name.strip("/").replace("/", "-")
    latest = events[-MOST:]
    rows: list[tuple[Cell, ...]] = [(_at(event.begin, SECOND), event.text) for event in latest]
    left = f", the last {MOST} of them" if len(events) > len(latest) else ""
    table = Table(f"events{name}", f"{_count(len(events), 'event')}{left}", EVENTS, rows)
    of_loop = f" in {history.name}" if history.name else ""
    figure = Figure(f"time{name}", "", tuple(_panels(history)))
    yield Section(f"over-time{name}", f"Over time{of_loop}", "", figures=[figure])
    yield Section(f"what-happened{name}", f"What happened{of_loop}", "", tables=[table])


def _panels(history: History) -> Iterator[Panel]:
    rows = history.rows
    width = _width(float(rows.time[-1] - rows.time[0]), rows)
    amplitude = np.repeat(rows.amplitude[:, None], 3, axis=1)
    thin = gather(replace(rows, x=amplitude), width)
    time = thin.time + 0.5 * width
    marks = tuple(
        Mark(int(trip.begin), "trip", int(trip.begin), math.ceil(trip.end), 1)
        for trip in trips(history)[:MARKS]
    )

    def curves(values: Floats, *names: str) -> tuple[Series, ...]:
        return tuple(
            series
            for i, name in enumerate(names)
            for low, high, mean in [values[:, :, i].T]
            for series in _curve(name, time, width, mean, low, high, i)
        )

    series = curves(thin.x, *history.channels)
    yield Panel(TIME, "amplitude", series, "Amplitude", time=True)
    n = thin.theta.shape[2]
    knobs = [f"theta[{i}]" for i in range(n)] if n > 1 else ["theta"]
    title = "Theta, and trips, in which it is the guard's"
    yield Panel(TIME, "theta", curves(thin.theta, *knobs), title, marks=marks, time=True)
    low, high = thin.r[:, 0], thin.r[:, 1]
    positive = bool(np.nanmin(low, initial=np.inf) > 0.0)
    wide = positive and np.nanmax(high, initial=1.0) > 50.0 * np.nanmin(low, initial=1.0)
    yield Panel(TIME, "cost r", curves(thin.r, "r"), "Cost", log_y=bool(wide), time=True)
    if np.isfinite(thin.margin).any():
        title = "Margin of the constraint, below 0: broken"
        yield Panel(TIME, "margin", curves(thin.margin, "margin"), title, time=True)
    yield Panel(
        TIME, "level", (_levels(history, troubles(history)),),
        "Health: the worst node; 0 OK, 1 WARN, 2 ERROR, 3 STALE", time=True,
    )  # fmt: skip


def _width(span: float, rows: Rows) -> float:
    """Return the length of the intervals that a figure shows: whole rows [s]."""
    step = float(np.median(np.diff(rows.time))) if rows.time.size > 1 else 1.0
    return max(1.0, math.ceil(span / POINTS / step)) * step


def _curve(
    name: str, time: Floats, width: float, mean: Floats, low: Floats, high: Floats, color: int
) -> Iterator[Series]:
    """Yield a band and a curve in it, broken where nothing was recorded."""
    gaps = np.flatnonzero(np.diff(time) > 1.5 * width) + 1
    x = np.insert(time, gaps, time[gaps - 1] + width).astype(np.int64).tolist()
    curve, lower, upper = (np.insert(v, gaps, np.nan).tolist() for v in (mean, low, high))
    yield Series(name, x, lower, "band", upper, color)
    yield Series(name, x, curve, color=color)


def _levels(history: History, ill: Sequence[Trouble]) -> Series:
    """Return the worst level of all nodes as steps."""
    edges = sorted({t for trouble in ill for t in (trouble.begin, trouble.end)})
    begin, end = history.runs[0].begin, max(run.end for run in history.runs)
    times = [begin, *edges, end]
    levels = [max((t.level for t in ill if t.begin <= time < t.end), default=0) for time in times]
    top = len(LEVELS) - 1
    return Series("worst", [int(t) for t in times], [min(n, top) for n in levels], "steps", (), 1)


def _length(spans: Sequence[tuple[float, float]]) -> float:
    """Return the time [s] that spans cover together."""
    total, reached = 0.0, -math.inf
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    return total


def _share(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.4g} %" if whole > 0.0 else "all"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _at(time: float, form: str) -> str:
    return f"{datetime.fromtimestamp(time, timezone.utc):{form}}"
