"""The report: one HTML page that needs nothing else, not even a network."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import yaml

from koop_core.whole_file import write_text
from koop_study.experiments.kinds import Experiment
from koop_study.report import summary
from koop_view.report import markup
from koop_view.report.document import Section

TITLE = "Extremum seeking in a Koopman-lifted space: the study"


def write(
    folder: Path, sections: Sequence[Section], experiments: Sequence[Experiment], command: str
) -> Path:
    """Write report.html and tables/*.csv; return the page's path. See :func:`render`."""
    (folder / "tables").mkdir(parents=True, exist_ok=True)
    for section in sections:
        for table in section.tables:
            write_text(folder / "tables" / f"{table.name}.csv", table.csv())
    path = folder / "report.html"
    write_text(path, render(sections, experiments, command))
    return path


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
    head = [
        _summary(sections),
        "<p>Salsbury, Yu and Mukherjee, <i>Data-Driven Koopman-Enhanced Extremum Seeking for "
        "Oscillation Damping in Nonlinear Systems</i> (arXiv 2605.06804), reproduced, tested "
        "and taken further. Every sentence of this page is made from the table that it links "
        f"to. {markup.HINT}</p>",
        markup.contents(sections, "<a href='#settings'>Settings</a>"),
    ]
    return markup.page(TITLE, head, sections, _settings(experiments, command))


def _summary(sections: Sequence[Section]) -> str:
    tables = summary.by_name(sections)
    table = summary.headline(tables)
    words = "".join(
        f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>"
        for name, text in summary.METRICS
    )
    return markup.lines(
        [
            markup.claims(summary.sentences(tables)),
            markup.table(table) if table else "",
            f"<dl>{words}</dl>",
        ]
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
