"""Write a finished study: page, tables and pictures; and the README's results from the tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from koop_study.experiments.kinds import Experiment
from koop_study.report import page, picture, summary
from koop_study.workers.units import write_atomically
from koop_view.report.document import Section
from koop_view.report.markdown import markdown, rewrite_block

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
        text = rewrite_block(text, readme_block(sections, report), (BEGIN, END))
    return text
