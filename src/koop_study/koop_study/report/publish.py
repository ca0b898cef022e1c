"""Write a finished study: page, tables and pictures; and the README's results from the tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from koop_lab.page.document import Section, Table
from koop_study.experiments.kinds import Experiment
from koop_study.report import page, picture, summary
from koop_study.workers.units import write_atomically

BEGIN, END = "<!-- results -->", "<!-- /results -->"
LAWS = "<!-- laws -->", "<!-- /laws -->"


def write(
    folder: Path, sections: Sequence[Section], experiments: Sequence[Experiment], command: str
) -> Path:
    """Write report.html, tables/*.csv and pictures; return the page's path."""
    (folder / "tables").mkdir(parents=True, exist_ok=True)
    for section in sections:
        for table in section.tables:
            write_atomically(folder / "tables" / f"{table.name}.csv", table.csv())
        for figure in section.figures:
            if figure.picture:
                picture.draw(figure, folder / figure.picture)
    path = folder / "report.html"
    write_atomically(path, page.render(sections, experiments, command))
    return path


def markdown(table: Table) -> str:
    """Return a table as Markdown."""
    heads = [column.title for column in table.columns]
    lines = [heads, ["---"] * len(heads), *table.texts()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def readme_block(sections: Sequence[Section], report: str) -> str:
    """Return the README's results: the table of the report's summary, and where the rest is."""
    table = summary.headline(summary.by_name(sections))
    shown = [f"{table.title}:", markdown(table)] if table else []
    link = f"All tables and figures: [{report}]({report}), made by `koop study`."
    return "\n\n".join([*shown, link])


def rewrite(text: str, sections: Sequence[Section], report: str) -> str:
    """Return a README with the blocks rewritten that the sections have something for.

    A run of the experiment ``laws`` alone leaves the results as they are, and one without it the
    sentence on laws.
    """
    sentence = summary.laws(summary.by_name(sections))
    if sentence:
        text = rewrite_block(text, f"{sentence} All tables: [{report}]({report}).", LAWS)
    if any(section.name != "laws" for section in sections):
        text = rewrite_block(text, readme_block(sections, report))
    return text


def rewrite_block(text: str, block: str, markers: tuple[str, str] = (BEGIN, END)) -> str:
    """Return ``text`` with what stands between two markers replaced by ``block``.

    Raises
    ------
    ValueError
        If the markers are not there, once each and in order.
    """
    begin, end = markers
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ValueError(f"needs one '{begin}' and, after it, one '{end}'")
    pattern = re.escape(begin) + ".*?" + re.escape(end)
    return re.sub(pattern, lambda _: f"{begin}\n{block}\n{end}", text, flags=re.DOTALL)
