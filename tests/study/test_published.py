"""What README, published tables and published report say of the same runs is the same."""

from __future__ import annotations

import csv
import html
import re
from pathlib import Path

import pytest

from koop_study.report import publish

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
STUDY = ROOT / "docs" / "study"


def rows(name: str) -> list[dict[str, str]]:
    with (STUDY / "tables" / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_readmes_table_is_that_of_the_published_study() -> None:
    block = README.split(publish.BEGIN)[1].split(publish.END)[0]
    lines = [line.strip("| ").split(" | ") for line in block.splitlines() if line.startswith("|")]
    expected = [
        [
            row["cost"],
            *(f"{float(row[name]):.0f}" for name in ("iae_median", "iae_p90")),
            f"{float(row['t_theta_median']):.0f}" if row["t_theta_median"] else "–",
            f"{float(row['converged']):.0f}",
            f"{float(row['e_r_ss_median']):.5f}",
        ]
        for row in rows("robustness")
    ]
    assert lines[2:] == expected


@pytest.mark.parametrize(
    ("label", "column", "form"),
    [
        ("IAE_theta [s]", "iae", ".1f"),
        ("ISE_theta [s]", "ise", ".1f"),
        ("T_theta [s]", "t_theta", ".1f"),
        ("e_r_ss", "e_r_ss", ".5f"),
        ("mean |theta - theta*|, last 30 %", "tail", ".3f"),
    ],
)
def test_the_demo_is_the_studys_run(label: str, column: str, form: str) -> None:
    (shown,) = re.findall(rf"^{re.escape(label)}\s+(\S+)", README, re.MULTILINE)
    (lifted,) = (row for row in rows("closed_loop") if row["method"] == "lifted")
    assert shown == format(float(lifted[column]), form)


def test_the_report_shows_the_published_tables() -> None:
    page = html.unescape((STUDY / "report.html").read_text())
    for row in rows("closed_loop"):
        assert f"<td>{row['method']}</td><td>{float(row['iae']):.0f}</td>" in page
    for row in rows("modes_spread"):
        assert f"<td>{float(row['median']):.6f}</td>" in page


def test_the_readmes_figures_of_laws_are_those_of_the_published_tables() -> None:
    begin, end = publish.LAWS
    block = README.split(begin)[1].split(end)[0]
    tables = STUDY / "tables"
    carried = set()
    for path in tables.glob("laws_*_calm.csv"), tables.glob("laws_*_jumps.csv"):
        for table in path:
            with table.open(encoding="utf-8") as file:
                for row in csv.DictReader(file):
                    form = ".2f" if "family" in table.name else ".0f"
                    carried.add(f"{float(row['median']):{form}} / {float(row['p90']):{form}}")
    shown = re.findall(r"\d+(?:\.\d+)? / \d+(?:\.\d+)?", block)
    assert len(shown) == 8
    assert set(shown) <= carried
