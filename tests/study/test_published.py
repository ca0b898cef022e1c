"""What README, published tables and published report say of the same runs is the same."""

from __future__ import annotations

import csv
import html
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
TERMINAL = html.unescape((ROOT / "docs" / "images" / "terminal.svg").read_text())
STUDY = ROOT / "docs" / "study"


def rows(name: str) -> list[dict[str, str]]:
    with (STUDY / "tables" / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_readmes_results_are_those_of_the_published_study() -> None:
    for row in rows("robustness"):
        (line,) = re.findall(rf"^\| {re.escape(row['cost'])} \|.*", README, re.MULTILINE)
        for name in ("iae_median", "iae_p90", "converged"):
            assert f" {float(row[name]):.0f} " in line


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
    (shown,) = re.findall(rf">{re.escape(label)}\s+([^\s<]+)", TERMINAL.replace("\xa0", " "))
    (lifted,) = (row for row in rows("closed_loop") if row["method"] == "lifted")
    assert shown == format(float(lifted[column]), form)


def test_the_report_shows_the_published_tables() -> None:
    page = html.unescape((STUDY / "report.html").read_text())
    for row in rows("closed_loop"):
        assert f"<td>{row['method']}</td><td>{float(row['iae']):.0f}</td>" in page
    for row in rows("modes_spread"):
        assert f"<td>{float(row['median']):.6f}</td>" in page
