"""Sections as HTML: one page that needs nothing else, not even a network."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from koop_view.report.document import Claim, Column, Figure, Section, Table

HINT = (
    "In figures: point at a curve to read it, drag to zoom in, double-click to zoom out, click a "
    "name to hide it."
)
DIGITS = 5  # significant, of the points of figures
LONG = 40  # characters of a cell, above which its words are wrapped


def page(title: str, head: Sequence[str], sections: Sequence[Section], end: str = "") -> str:
    """Return a page: its title, HTML, part after part, then the sections, and HTML at the end."""
    body = [f"<h1>{html.escape(title)}</h1>", *head, *map(section, sections), end]
    frame = (files("koop_view") / "page" / "report.html").read_text(encoding="utf-8")
    figures = {f.name: _plain(asdict(f)) for part in sections for f in part.figures}
    data = json.dumps(figures, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    before, middle, script, after = re.split("<!--(?:TITLE|BODY|FIGURES)-->", frame)
    data = data.replace("<", "\\u003c")  # no string may end the script element
    return "".join([before, html.escape(title), middle, lines(body), script, data, after])


def contents(sections: Sequence[Section], more: str = "") -> str:
    """Return links to sections, and ``more`` of them as HTML."""
    links = "".join(f'<a href="#{part.name}">{html.escape(part.title)}</a>' for part in sections)
    return f"<nav>{links}{more}</nav>"


def verdict(sentences: Iterable[str]) -> str:
    """Return the sentences that a page begins with."""
    return f'<div class="verdict">{"".join(f"<p>{html.escape(s)}</p>" for s in sentences)}</div>'


def _plain(value: Any) -> Any:
    """Return JSON terms with numbers rounded, no eye sees the rest; None for one not finite."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def section(part: Section) -> str:
    """Return a section: its tables, then its figures with theirs."""
    parts = [
        f'<h2 id="{part.name}">{html.escape(part.title)}</h2>',
        f"<p>{html.escape(part.intro)}</p>",
    ]
    # what belongs to one figure stands with it, the rest before all figures
    named = {figure.name for figure in part.figures} - {part.name}
    parts += [table(item) for item in part.tables if item.name not in named]
    for figure in part.figures:
        tables = [item for item in part.tables if item.name == figure.name in named]
        parts.append(_figure(figure, tables))
    return f"<section>{lines(parts)}</section>"


def lines(parts: Sequence[str]) -> str:
    """Return the parts that are there, one below the other."""
    return "\n".join(part for part in parts if part)


def claims(sentences: Sequence[Claim]) -> str:
    """Return sentences as a list, each with a link to its table."""
    items = [
        f"<li>{html.escape(claim.text)} "
        f'<small><a href="#table-{claim.table}">table</a></small></li>'
        for claim in sentences
    ]
    return f"<ul>\n{''.join(items)}\n</ul>" if items else ""


def table(content: Table) -> str:
    """Return a table."""
    head = "".join(
        f"<th{_left(column)}>{html.escape(column.title)}</th>" for column in content.columns
    )
    rows = []
    for cells, texts in zip(content.rows, content.texts(), strict=True):
        row = []
        for cell, text, column in zip(cells, texts, content.columns, strict=True):
            long = isinstance(cell, str) and len(cell) > LONG
            words = ' class="words"' if long else _left(column)
            row.append(f"<td{words}>{html.escape(text)}</td>")
        rows.append(f"<tr>{''.join(row)}</tr>")
    caption = "" if content.detail else f"<caption>{html.escape(content.title)}</caption>"
    text = (
        f'<div class="scroll" id="table-{content.name}"><table>{caption}'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )
    if content.detail:
        return f"<details><summary>{html.escape(content.title)}</summary>{text}</details>"
    return text


def _left(column: Column) -> str:
    return ' class="left"' if column.words else ""


def _figure(figure: Figure, tables: Sequence[Table]) -> str:
    panels = []
    for i, panel in enumerate(figure.panels):
        title = f'<div class="panel-title">{html.escape(panel.title)}</div>' if panel.title else ""
        plot = f'<div class="plot" data-figure="{figure.name}" data-panel="{i}"></div>'
        panels.append(f'<div class="panel">{title}{plot}</div>')
    return (
        f"<figure><figcaption>{html.escape(figure.caption)}</figcaption>"
        f'<div class="panels columns-{figure.columns}">{"".join(panels)}</div>'
        f"{''.join(table(item) for item in tables)}</figure>"
    )
