"""``koop study --quick`` from end to end: sentences, tables, figures, and the page in a browser."""

from __future__ import annotations

import csv
import html
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import pytest

from koop_study.experiments.kinds import read_folder
from koop_study.report import publish
from koop_study.report.document import Figure, Heat, Panel, Section, Series
from koop_study.report.page import render
from koop_study.workers.runner import run_all
from koop_study.workers.units import Store

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
# The report in a frame as wide as a phone or a desk, and what it looks like there.
FRAME = """<!DOCTYPE html><body><iframe id="f" style="width:{width}px;height:900px;border:0"
srcdoc="{page}"></iframe><script>
document.getElementById("f").onload = () => setTimeout(() => {{
  const page = document.getElementById("f").contentDocument, root = page.documentElement;
  const holders = [...page.querySelectorAll("[data-figure]")];
  const empty = holders.filter((h) => [...h.querySelectorAll("svg")].some(
    (s) => !s.querySelector(".data"))).map((h) => h.dataset.figure);
  const wide = [...page.querySelectorAll("svg")].filter(
    (s) => s.getBoundingClientRect().right > root.clientWidth + 1).length;
  const small = [...page.querySelectorAll("svg text")].filter(
    (t) => parseFloat(page.defaultView.getComputedStyle(t).fontSize) < 10).length;
  const button = page.querySelector(".legend button"), panel = button.closest(".panel");
  const before = panel.querySelectorAll(".data").length;
  button.click();
  const result = {{width: root.clientWidth, content: root.scrollWidth, drawn: holders.length, empty,
    wide, small, toggled: before - panel.querySelectorAll(".data").length}};
  document.body.dataset.result = JSON.stringify(result);
}}, 500);
</script></body>"""


@dataclass(frozen=True)
class Quick:
    """A finished quick study."""

    out: Path
    printed: str
    sections: list[Section]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Quick:
    out = tmp_path_factory.mktemp("study")
    done = subprocess.run(
        [sys.executable, "-m", "koop_lab", "study", "--quick", "--out", str(out),
         "--experiments", str(EXPERIMENTS)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    sections = run_all(read_folder(EXPERIMENTS, True), Store(out / "units"), 1)
    return Quick(out, done.stdout, sections)


@pytest.mark.slow
def test_every_number_of_a_sentence_stands_in_the_table_it_cites(quick: Quick) -> None:
    tables = {table.name: table for section in quick.sections for table in section.tables}
    number = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
    checked = 0
    for claim in (claim for section in quick.sections for claim in section.claims):
        table = tables[claim.table]
        heads = [table.title, *(column.title for column in table.columns)]
        carried = {
            found
            for text in [*heads, *(cell for row in table.texts() for cell in row)]
            for found in number.findall(text)
        }
        text = claim.text.replace("90th percentile", "")
        for found in number.findall(text):
            assert found in carried, f"{found} of '{claim.text}' is not in {claim.table}"
            checked += 1
    assert checked > 100


@pytest.mark.slow
def test_every_table_is_a_csv_and_every_figure_an_svg(quick: Quick) -> None:
    for section in quick.sections:
        for table in section.tables:
            with (quick.out / "tables" / f"{table.name}.csv").open(encoding="utf-8") as file:
                rows = list(csv.reader(file))
            assert rows[0] == [column.key for column in table.columns]
            assert len(rows) == len(table.rows) + 1
        for figure in section.figures:
            path = quick.out / "figures" / f"{figure.name}.svg"
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


@pytest.mark.slow
def test_the_lifted_cost_does_what_the_paper_claims_on_the_quick_seeds(quick: Quick) -> None:
    (table,) = (t for s in quick.sections for t in s.tables if t.name == "robustness")
    assert float(table.cell("lifted", "iae_median")) <= 1150
    assert table.cell("lifted", "reached") == "100"
    assert float(table.cell("lifted", "win_rate")) >= 95
    assert float(table.cell("contrast", "iae_median")) < float(table.cell("lifted", "iae_median"))


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_draws_every_figure_without_an_error(
    quick: Quick, width: int, tmp_path: Path
) -> None:
    result, errors = browse((quick.out / "report.html").read_text(), width, tmp_path)
    assert errors == []
    assert width - 20 <= result["width"] <= width  # less the scroll bar
    assert result["content"] <= result["width"]  # nothing makes the page scroll sideways
    assert result["drawn"] == sum(len(section.figures) for section in quick.sections)
    assert result["empty"] == []
    assert result["wide"] == 0
    assert result["small"] == 0
    assert result["toggled"] == 1  # a click on a name hides its curve


@pytest.mark.slow
def test_the_page_needs_no_network(quick: Quick) -> None:
    page = (quick.out / "report.html").read_text()
    assert not re.search(r"""(?:src|href)=["']?(?:https?:)?//""", page)
    assert "@import" not in page
    assert "fetch(" not in page
    assert len(page) < 3_000_000


def test_an_error_on_the_page_is_noticed(tmp_path: Path) -> None:
    page = "<body><figure class='panel'><div class='legend'><button></button></div></figure>"
    _, errors = browse(page + "<script>nothing.there()</script>", 390, tmp_path)
    assert len(errors) == 1
    assert "nothing is not defined" in errors[0]


def test_a_string_cannot_end_the_script() -> None:
    heat = Heat(["a"], ["b"], [[None]], 1.0, 10.0)
    panels = (Panel("x", "y", (Series("</script>", [1.0], [2.0]),)), Panel("x", "y", heat=heat))
    section = Section("s", "S", "<i>", figures=[Figure("f", "c", panels)])
    page = render([section], [], "koop study")
    assert page.count("</script>") == 1
    assert "&lt;i&gt;" in page


def test_a_readmes_block_is_rewritten_and_the_rest_left_alone() -> None:
    text = f"before\n{publish.BEGIN}\nold \\1\n{publish.END}\nafter\n"
    expected = f"before\n{publish.BEGIN}\nnew \\2\n{publish.END}\nafter\n"
    assert publish.rewrite_block(text, "new \\2") == expected


@pytest.mark.parametrize("text", ["", publish.BEGIN, f"{publish.END} {publish.BEGIN}"])
def test_a_readme_without_markers_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="needs one"):
        publish.rewrite_block(text, "new")


def browse(page: str, width: int, folder: Path) -> tuple[dict, list[str]]:
    """Open a page in headless Chromium in a frame of ``width``; return its state and errors."""
    import json

    browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if browser is None:
        pytest.skip("no Chromium: `./koop test` says how to get one")
    path = folder / "frame.html"
    path.write_text(FRAME.format(width=width, page=html.escape(page)), encoding="utf-8")
    done = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=10000",
         "--window-size=1400,1000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "HOME": str(folder)},
    )  # fmt: skip
    found = re.search(r'data-result="([^"]*)"', done.stdout)
    assert found, done.stderr[-2000:]
    errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(found[1])), errors
