"""Write the page."""

from __future__ import annotations

import html
from pathlib import Path

from koop_commission.report.contents import Contents, read_contents
from koop_commission.report.sections import make_sections
from koop_commission.report.verdict import Stage, list_stages, write_sentences
from koop_core.errors import KoopError
from koop_core.whole_file import write_text
from koop_view.report import markup

NAME = "report.html"
SIGNS = {"done": "✓", "missing": "…", "no": "✗"}


def write_report(folder: Path) -> Path:
    """Write ``report.html`` into the folder of a commissioning; return its path.

    It shows each stage, and says what is missing.

    Raises
    ------
    koop_core.errors.KoopError
        If it is not a folder of ``koop excite``, a file in it cannot be read, or the page cannot
        be written.
    """
    page, path = _make_page(read_contents(folder)), folder / NAME
    write_text(path, page)
    return path


def try_report(folder: Path) -> str:
    """Write the page; return in a line where it is, or why there is none."""
    try:
        return f"report in {write_report(folder)}"
    except KoopError as error:
        return f"no report: {error}"


def _make_page(c: Contents) -> str:
    sections = list(make_sections(c))
    head = [
        markup.verdict(write_sentences(c)),
        f'<ol class="stages">{"".join(map(_format_stage, list_stages(c)))}</ol>',
        markup.contents(sections),
        f"<p><small>{markup.HINT}</small></p>",
    ]
    return markup.page(f"Commissioning: {c.folder.resolve().name}", head, sections)


def _format_stage(stage: Stage) -> str:
    return (
        f'<li class="{stage.state}"><b>{SIGNS[stage.state]} {html.escape(stage.name)}</b> '
        f"<span>{html.escape(stage.text)}</span></li>"
    )
