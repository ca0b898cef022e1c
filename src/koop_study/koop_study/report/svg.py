"""Figures as SVG files, drawn by Matplotlib."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure as Canvas

from koop_study.report.document import Figure, Panel

COLORS = ("#1f77b4", "#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e", "#a6761d", "#666666")
STYLES = ("-", "--")  # the second for series beyond the colours


def render(figure: Figure) -> str:
    """Return the figure as SVG text; the same figure gives the same text."""
    rows = -(-len(figure.panels) // figure.columns)
    settings = {"svg.hashsalt": figure.name, "svg.fonttype": "none", "font.size": 9}
    with matplotlib.rc_context(settings):
        size = (4.6 * figure.columns + 2.0, 2.6 * rows + 0.4)
        canvas = Canvas(figsize=size, layout="constrained")
        axes = canvas.subplots(rows, figure.columns, squeeze=False).ravel()
        for axis, panel in zip(axes, figure.panels, strict=False):
            _draw(axis, panel)
        for axis in axes[len(figure.panels) :]:
            axis.set_visible(False)
        text = io.StringIO()
        canvas.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


def _draw(axis: Any, panel: Panel) -> None:
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    axis.set_title(panel.title, fontsize=9)
    if panel.heat:
        _draw_heat(axis, panel)
        return
    if panel.log_x:
        axis.set_xscale("log")
    if panel.log_y:
        axis.set_yscale("log")
    names = [series.name for series in panel.series]
    for i, series in enumerate(panel.series):
        label = series.name if names.index(series.name) == i else None
        look: dict[str, Any] = {"color": COLORS[series.color % len(COLORS)]}
        style = STYLES[series.color // len(COLORS) % len(STYLES)]
        y = [float("nan") if v is None else v for v in series.y]
        if series.kind == "band":
            upper = [float("nan") if v is None else v for v in series.upper]
            axis.fill_between(series.x, y, upper, label=label, alpha=0.25, **look)
            if len(panel.series) == 1:  # a thinned trace is nothing but its band
                axis.fill_between(series.x, y, upper, linewidth=0.6, **look)
        elif series.kind == "points":
            axis.plot(series.x, y, "o", markersize=4, label=label, **look)
        elif series.kind == "steps":
            axis.step(series.x, y, where="post", linestyle=style, label=label, **look)
        else:
            axis.plot(series.x, y, linestyle=style, label=label, **look)
    if panel.level is not None:
        axis.axhline(panel.level, color="black", linestyle="--", linewidth=0.8)
    if panel.ticks:
        axis.set_xticks(range(len(panel.ticks)), panel.ticks)
    if len(set(names)) > 1:
        axis.legend(fontsize=7)
    axis.grid(alpha=0.3)


def _draw_heat(axis: Any, panel: Panel) -> None:
    heat = panel.heat
    assert heat is not None
    values = [[float("nan") if v is None else v for v in row] for row in heat.values]
    axis.imshow(
        values, origin="lower", aspect="auto", cmap="viridis_r", norm=LogNorm(heat.low, heat.high)
    )
    axis.set_xticks(range(len(heat.x)), heat.x)
    axis.set_yticks(range(len(heat.y)), heat.y)
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            dark = value > (heat.low * heat.high) ** 0.5
            axis.text(
                j, i, f"{value:.0f}", ha="center", va="center", fontsize=7,
                color="white" if dark else "black",
            )  # fmt: skip
