"""`koop bench all` runs what there is, and what fails takes nothing with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from koop_bench import everything
from koop_bench.command import BENCHMARKS
from koop_lab.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"


def page(folder: Path, *names: str) -> Path:
    file = folder / "page.md"
    blocks = [f"<!-- bench {name} -->\n<!-- end of bench {name} -->" for name in names]
    file.write_text("\n".join(["before", *blocks, "after"]))
    return file


def test_every_benchmark_is_planned_and_has_its_place_in_the_page():
    assert set(everything.PLAN) == {module.__name__.split(".")[-1] for module in BENCHMARKS}
    for name in (everything.MACHINE, *everything.PLAN):
        everything.replaced(PAGE.read_text(), name, "", PAGE)


def test_one_that_fails_loses_no_other(tmp_path, monkeypatch, capfd):
    plan = {"identify": ("identify",), "offline": ("offline --help",)}
    monkeypatch.setattr(everything, "PLAN", plan)
    monkeypatch.chdir(PAGE.parents[1])
    file = page(tmp_path, "machine", *plan)
    given = ["--write", str(file), "--python", str(tmp_path / "none")]
    assert main(["bench", "all", *given]) == 1
    text = file.read_text()
    assert "`./koop bench identify`" in text
    assert "failed with exit code 2" in text
    assert "No such file" in text  # what it said is there
    assert "usage: koop bench offline" in text
    assert "load average at the start" in text
    assert text.startswith("before\n")
    assert text.endswith("\nafter")
    assert "failed: 'koop bench identify'" in capfd.readouterr().err


def test_a_page_without_the_marks_is_said_before_anything_runs(tmp_path, capfd):
    file = page(tmp_path, "machine", "loop")
    assert main(["bench", "all", "--write", str(file)]) == 2
    said = capfd.readouterr()
    assert "needs one '<!-- bench realtime -->'" in said.err
    assert not said.out
    with pytest.raises(SystemExit):
        main(["bench", "all", "--only", "nothing"])
