"""Write the page."""

from __future__ import annotations

import html
from pathlib import Path

from koop_bag.errors import BagError
from koop_commission.report.gathered import Gathered, gather
from koop_commission.report.sections import sections
from koop_commission.report.verdict import Stage, sentences, stages
from koop_core.config.parameter import ConfigError
from koop_view.report import markup

NAME = "report.html"
SIGNS = {"done": "✓", "missing": "…", "no": "✗"}


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a commissioning; return its path.

    It shows what is there, stage by stage, and says what is missing.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the folder is not one of ``koop excite``, or a file in it cannot be read.
    OSError
        If it cannot be written.
    """
    try:
        page = _page(gather(folder))
    except (KeyError, IndexError, TypeError) as error:  # files of another version, or edited ones
        raise ConfigError(f"{folder}: cannot be shown: {error!r} in one of its files") from None
    path = folder / NAME
    path.write_text(page, encoding="utf-8")
    return path


def _page(found: Gathered) -> str:
    parts = list(sections(found))
    folder = found.folder
    title = f"Commissioning: {folder.resolve().name}"
    links = "".join(f'<a href="#{part.name}">{html.escape(part.title)}</a>' for part in parts)
    said = "".join(f"<p>{html.escape(text)}</p>" for text in sentences(found))
    body = [
        f"<h1>{html.escape(title)}</h1>",
        f'<div class="verdict">{said}</div>',
        f'<ol class="stages">{"".join(map(_stage, stages(found)))}</ol>',
        f"<nav>{links}</nav>",
        "<p><small>In figures: point at a curve to read it, drag to zoom in, double-click to zoom "
        "out, click a name to hide it.</small></p>",
        *map(markup.section, parts),
    ]
    return markup.page(title, body, parts)


def try_report(folder: Path) -> str:
    """Write the page; return in a line where it is, or why there is none."""
    try:
        return f"report in {write_report(folder)}"
    except (BagError, ValueError, OSError, ArithmeticError) as error:
        return f"no report: {error}"


def _stage(stage: Stage) -> str:
    return (
        f'<li class="{stage.state}"><b>{SIGNS[stage.state]} {html.escape(stage.name)}</b> '
        f"<span>{html.escape(stage.text)}</span></li>"
    )
