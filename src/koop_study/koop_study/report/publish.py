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


def rewrite_block(text: str, block: str) -> str:
    """Return ``text`` with what stands between the two markers replaced by ``block``.

    Raises
    ------
    ValueError
        If the markers are not there, once each and in order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"needs one '{BEGIN}' and, after it, one '{END}'")
    pattern = re.escape(BEGIN) + ".*?" + re.escape(END)
    return re.sub(pattern, lambda _: f"{BEGIN}\n{block}\n{END}", text, flags=re.DOTALL)
