"""The report: one HTML page that needs nothing else, not even a network."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from typing import Any

import yaml

from koop_study.experiments.kinds import Experiment
from koop_study.report import summary
from koop_study.report.document import Claim, Figure, Section, Table
from koop_study.report.heat import heat_table

TITLE = "Extremum seeking in a Koopman-lifted space: the study"
DIGITS = 5  # significant, of the points of figures


def render(sections: Sequence[Section], experiments: Sequence[Experiment], command: str) -> str:
    """Return the page.

    Parameters
    ----------
    sections : sequence of Section
        Parts of the report, in order.
    experiments : sequence of Experiment
        What was run; the page ends with their settings.
    command : str
        What makes the page again.
    """
    folder = files("koop_study.report")
    vendor = folder / "vendor"
    license_text = (vendor / "LICENSE").read_text().strip()
    figures = {f.name: _plain(asdict(f)) for section in sections for f in section.figures}
    data = json.dumps(figures, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    data = data.replace("<", "\\u003c")  # no string may end the script element
    links = "".join(f'<a href="#{s.name}">{html.escape(s.title)}</a>' for s in sections)
    body = _lines(
        [
            f"<h1>{TITLE}</h1>",
            _summary(sections),
            "<p>Salsbury, Yu and Mukherjee, <i>Data-Driven Koopman-Enhanced Extremum Seeking for "
            "Oscillation Damping in Nonlinear Systems</i> (arXiv 2605.06804), reproduced, tested "
            "and taken further. Every sentence of this page is made from the table that it links "
            "to. In figures: point at a curve to read it, drag to zoom in, double-click to zoom "
            "out, click a name to hide it.</p>",
            f"<nav>{links}<a href='#settings'>Settings</a></nav>",
            *(_section(section) for section in sections),
            _settings(experiments, command),
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<link rel="icon" href="data:,">\n'
        f"<title>{TITLE}</title>\n<style>\n{(vendor / 'uPlot.min.css').read_text()}\n"
        f"{(folder / 'page.css').read_text()}</style>\n</head>\n<body>\n{body}\n"
        f'<script type="application/json" id="figures">{data}</script>\n'
        f"<script>\n/* uPlot: {license_text} */\n{(vendor / 'uPlot.iife.min.js').read_text()}\n"
        f"</script>\n<script>\n{(folder / 'page.js').read_text()}</script>\n</body>\n</html>\n"
    )


def _plain(value: Any) -> Any:
    """Return JSON terms with numbers rounded: no eye sees the rest."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _summary(sections: Sequence[Section]) -> str:
    tables = summary.by_name(sections)
    table = summary.headline(tables)
    words = "".join(
        f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>"
        for name, text in summary.METRICS
    )
    return _lines(
        [
            _claims(summary.sentences(tables)),
            _table(table) if table else "",
            f"<dl>{words}</dl>",
        ]
    )


def _section(section: Section) -> str:
    parts = [
        f'<h2 id="{section.name}">{html.escape(section.title)}</h2>',
        f"<p>{html.escape(section.intro)}</p>",
    ]
    # what belongs to one figure stands with it, the rest before all figures
    own = {figure.name for figure in section.figures} - {section.name}
    parts.append(_claims([claim for claim in section.claims if claim.table not in own]))
    parts += [_table(table) for table in section.tables if table.name not in own]
    for figure in section.figures:
        claims = [claim for claim in section.claims if claim.table == figure.name in own]
        tables = [table for table in section.tables if table.name == figure.name in own]
        parts.append(_figure(figure, claims, tables))
    return f"<section>{_lines(parts)}</section>"


def _lines(parts: Sequence[str]) -> str:
    return "\n".join(part for part in parts if part)


def _claims(claims: Sequence[Claim]) -> str:
    items = [
        f"<li>{html.escape(claim.text)} "
        f'<small><a href="#table-{claim.table}">table</a></small></li>'
        for claim in claims
    ]
    return f"<ul>\n{''.join(items)}\n</ul>" if items else ""


def _table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(column.title)}</th>" for column in table.columns)
    rows = []
    for cells, texts in zip(table.rows, table.texts(), strict=True):
        row = []
        for cell, text in zip(cells, texts, strict=True):
            words = ' class="words"' if isinstance(cell, str) and len(cell) > 40 else ""
            row.append(f"<td{words}>{html.escape(text)}</td>")
        rows.append(f"<tr>{''.join(row)}</tr>")
    caption = "" if table.detail else f"<caption>{html.escape(table.title)}</caption>"
    text = (
        f'<div class="scroll" id="table-{table.name}"><table>{caption}'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )
    if table.detail:
        return f"<details><summary>{html.escape(table.title)}</summary>{text}</details>"
    return text


def _figure(figure: Figure, claims: Sequence[Claim], tables: Sequence[Table]) -> str:
    panels = []
    for i, panel in enumerate(figure.panels):
        title = f'<div class="panel-title">{html.escape(panel.title)}</div>' if panel.title else ""
        content = (
            heat_table(panel, panel.heat) if panel.heat
            else f'<div class="plot" data-figure="{figure.name}" data-panel="{i}"></div>'
        )  # fmt: skip
        panels.append(f'<div class="panel">{title}{content}</div>')
    said = "".join(f"<p>{html.escape(claim.text)}</p>" for claim in claims)
    return (
        f"<figure><figcaption>{html.escape(figure.caption)}</figcaption>"
        f'<div class="panels columns-{figure.columns}">{"".join(panels)}</div>{said}'
        f"{''.join(_table(table) for table in tables)}</figure>"
    )


def _settings(experiments: Sequence[Experiment], command: str) -> str:
    parts = [
        '<h2 id="settings">Settings</h2>',
        "<p>This command makes the page again, with the same numbers:</p>",
        f"<pre>{html.escape(command)}</pre>",
    ]
    for experiment in experiments:
        text = yaml.safe_dump(experiment.content, sort_keys=False, default_flow_style=None)
        parts.append(
            f"<details><summary>{html.escape(experiment.path.name)}</summary>"
            f"<pre>{html.escape(text)}</pre></details>"
        )
    return "\n".join(parts)
