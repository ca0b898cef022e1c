"""Write a finished study: page, tables, figures; and the README's table from the tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from koop_study.experiments.kinds import Experiment
from koop_study.report import page, svg
from koop_study.report.document import Section, Table
from koop_study.workers.units import write_atomically

BEGIN, END = "<!-- results -->", "<!-- /results -->"


def write(
    folder: Path, sections: Sequence[Section], experiments: Sequence[Experiment], command: str
) -> Path:
    """Write report.html, tables/*.csv and figures/*.svg; return the page's path."""
    for name in ("tables", "figures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for section in sections:
        for table in section.tables:
            write_atomically(folder / "tables" / f"{table.name}.csv", table.csv())
        for figure in section.figures:
            write_atomically(folder / "figures" / f"{figure.name}.svg", svg.render(figure))
    path = folder / "report.html"
    write_atomically(path, page.render(sections, experiments, command))
    return path


def markdown(table: Table, columns: Sequence[str]) -> str:
    """Return some columns of a table as Markdown."""
    keys = [column.key for column in table.columns]
    chosen = [keys.index(name) for name in columns]
    lines = [
        "| " + " | ".join(table.columns[i].title for i in chosen) + " |",
        "|" + "---|" * len(chosen),
    ]
    lines += ["| " + " | ".join(texts[i] for i in chosen) + " |" for texts in table.texts()]
    return "\n".join(lines)


def readme_block(sections: Sequence[Section], report: str) -> str:
    """Return the README's results: the paper's table, the robustness, and how far one can go."""
    tables = {table.name: table for section in sections for table in section.tables}
    summary = ("iae_median", "iae_p90", "t_theta_median", "reached", "converged")
    parts = []
    if "closed_loop" in tables:
        columns = ("method", "iae", "ise", "t_theta", "e_r_ss")
        parts += ["One run, beside the paper:", markdown(tables["closed_loop"], columns)]
    if "robustness" in tables:
        parts += [
            tables["robustness"].title + ":",
            markdown(tables["robustness"], ("cost", *summary, "win_rate")),
        ]
    if "beyond" in tables:
        parts += [
            tables["beyond"].title + ":",
            markdown(tables["beyond"], ("candidate", "constants", *summary)),
        ]
    parts.append(f"Figures, sensitivity, ablations: [{report}]({report}), made by `koop study`.")
    return "\n\n".join(parts)


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
