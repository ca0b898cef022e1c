"""``koop study --quick`` from end to end: sentences, tables, figures, and the page in a browser."""

from __future__ import annotations

import csv
import fcntl
import html
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from browser import browse

from koop_study.experiments import stats
from koop_study.experiments.kinds import read, read_folder
from koop_study.report import summary
from koop_study.report.page import render
from koop_study.session import run_all
from koop_study.simulation.work import runs
from koop_study.workers.units import Store
from koop_view.report.document import Figure, Panel, Section, Series

# the first test waits for a study, which another process may be computing
pytestmark = pytest.mark.timeout(900)
EXPERIMENTS = Path(__file__).parents[2] / "experiments"
# What makes an experiment a matter of seconds; the pages and sentences are the same.
SMALL = {
    "duration": 300,
    "training.trajectories": 6,
    "training.duration": 5,
    "plant.drift_frequency": 0.1,
}


@dataclass(frozen=True)
class Quick:
    """A finished quick study."""

    out: Path
    printed: str
    sections: list[Section]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Quick:
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # of all processes of this test run: one study serves them all
    folder, out = shared / "small_experiments", shared / "small_study"
    printed = shared / "small_study.txt"
    with open(shared / "small_study.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not printed.exists():
            write_small(folder)
            done = subprocess.run(
                [sys.executable, "-m", "koop_lab", "study", "--quick", "--out", str(out),
                 *map(str, folder.glob("*.yaml"))],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            printed.write_text(done.stdout)
        sections = run_all(read_folder(folder, True), Store(out / "units"), 1)
    return Quick(out, printed.read_text(), sections)


def write_small(folder: Path) -> None:
    """Write the repository's experiments with everything that takes long made small."""
    folder.mkdir()
    for path in EXPERIMENTS.glob("*.yaml"):
        content = yaml.safe_load(path.read_text())
        without = ("modes", "static_maps")  # whose units have a length of their own
        is_fixed = content["experiment"] in without
        if content["experiment"] != "commission":
            content["settings"] = {
                k: v for k, v in SMALL.items() if not (is_fixed and k == "duration")
            }
        for table in content.get("tables", ()):
            if table["name"] in ("ablation_trajectories", "ablation_training_duration"):
                table["values"] = [4, 8]
        if content["experiment"] == "commission":
            names = ("usual", "two modes", "no optimum")
            content["strata"] = {name: content["strata"][name] for name in names}
            content["quick"] |= {"effort": 0.02, "excitation": 50, "duration": 20}
        (folder / path.name).write_text(yaml.safe_dump(content))


@pytest.mark.slow
def test_every_number_of_a_sentence_stands_in_the_table_it_cites(quick: Quick) -> None:
    tables = {table.name: table for section in quick.sections for table in section.tables}
    number = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
    checked = 0
    for claim in summary.sentences(tables):
        table = tables[claim.table]
        heads = [table.title, *(column.title for column in table.columns)]
        carried = {
            actual
            for text in [*heads, *(cell for row in table.texts() for cell in row)]
            for actual in number.findall(text)
        }
        text = claim.text.replace("90th percentile", "")
        for actual in number.findall(text):
            assert actual in carried, f"{actual} of '{claim.text}' is not in {claim.table}"
            checked += 1
    assert checked > 12


@pytest.mark.slow
def test_every_table_is_a_csv(quick: Quick) -> None:
    for section in quick.sections:
        for table in section.tables:
            with (quick.out / "tables" / f"{table.name}.csv").open(encoding="utf-8") as file:
                rows = list(csv.reader(file))
            assert rows[0] == [column.key for column in table.columns]
            assert len(rows) == len(table.rows) + 1


@pytest.mark.slow
def test_the_summary_opens_the_page_and_is_what_the_command_prints(quick: Quick) -> None:
    said = summary.sentences(summary.by_name(quick.sections))
    assert len(said) == 5
    page = (quick.out / "report.html").read_text()
    assert page.index(html.escape(said[0].text)) < page.index("<h2")
    assert quick.printed.splitlines()[:5] == [f"- {claim.text}" for claim in said]


@pytest.mark.slow
def test_the_lifted_cost_does_what_the_paper_claims_on_the_quick_seeds() -> None:
    config = read(EXPERIMENTS / "robustness.yaml", True).config
    seeds = config.seeds.list()
    raw, lifted, contrast = (
        runs({**config.settings, **config.costs[cost]}, seeds)
        for cost in ("raw", "lifted", "contrast")
    )
    assert stats.spread(lifted, "iae").median <= 1150
    assert stats.share(lifted, "reached") == 100
    assert stats.win_rate(lifted, raw) >= 95
    assert stats.spread(contrast, "iae").median < stats.spread(lifted, "iae").median


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "dark", "background"),
    [(390, False, "rgb(255, 255, 255)"), (1280, True, "rgb(20, 24, 30)")],
)
def test_the_page_draws_every_figure_without_an_error(
    quick: Quick, width: int, dark: bool, background: str, tmp_path: Path
) -> None:
    result, errors = browse((quick.out / "report.html").read_text(), width, tmp_path, dark)
    panels = [p for section in quick.sections for f in section.figures for p in f.panels]
    assert errors == []
    assert result["background"] == background
    assert width - 20 <= result["width"] <= width  # less the scroll bar
    assert result["content"] <= result["width"]  # nothing makes the page scroll sideways
    assert result["plots"] == len(panels)
    assert result["empty"] == []
    assert result["wide"] == 0
    assert result["small"] == 0
    # a click on a name hides its curve with its band; under the pointer the legend reads values
    assert set(result["hidden"]) == {False}
    assert result["fewer"]
    assert len([text for text in result["read"] if re.search(r"\d", text)]) >= 2
    assert result["zoomed"] == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_the_page_needs_no_network(quick: Quick) -> None:
    page = (quick.out / "report.html").read_text()
    assert not re.search(r"""(?:src|href)=["']?(?:https?:)?//""", page)
    assert "@import" not in page
    assert "fetch(" not in page
    assert len(page) < 3_000_000


def test_an_error_on_the_page_is_noticed(tmp_path: Path) -> None:
    _, errors = browse("<body><script>nothing.there()</script>", 390, tmp_path)
    assert len(errors) == 1
    assert "nothing is not defined" in errors[0]


def test_a_string_cannot_end_the_script() -> None:
    panels = (Panel("x", "y", (Series("</script><!--", [1.0], [2.0]),)),)
    section = Section("s", "S", "<i>", figures=[Figure("f", "c", panels)])
    page = render([section], [], "koop study")
    assert page.count("</script>") == 2  # data, and how to draw them
    assert "&lt;i&gt;" in page
