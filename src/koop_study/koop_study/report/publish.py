"""Write a finished study: page, tables and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from koop_study.experiments.kinds import Experiment
from koop_study.report import page, picture
from koop_study.workers.units import write_atomically
from koop_view.report.document import Section


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
