"""`koop bench` runs what is named, and the error of one benchmark ends no other."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

from koop_bench.command import BENCHMARKS, run_benchmarks
from koop_bench.figures import BenchFigure, BenchSettings
from koop_core.errors import KoopError
from koop_lab.cli.main import main


def fail(settings: BenchSettings) -> list[BenchFigure]:
    settings.show("before the end")
    raise KoopError("no more space")


def test_every_benchmark_is_a_module():
    for name in BENCHMARKS:
        assert import_module(f"koop_bench.{name}").run.__doc__


def test_one_that_fails_loses_no_other(capsys):
    figure = BenchFigure("speed", "2 steps/s", 0.5, "C")
    settings = BenchSettings(None, None, Path("python"), print)
    text, kept = run_benchmarks({"bad": fail, "good": lambda settings: [figure]}, settings)
    assert not kept
    assert "| good | speed | 2 steps/s | 0.5 x C |" in text
    assert "before the end\nfailed: no more space\n```" in text
    assert re.findall(r"^## (\w+)", text, re.MULTILINE) == ["bad", "good"]
    assert text.splitlines()[0] in capsys.readouterr().out


def test_a_promise_that_is_not_kept_is_a_failure():
    settings = BenchSettings(None, None, Path("python"), lambda text: None)
    late = BenchFigure("missing", "0.3 s", 1.5, "the limit", kept=False)
    text, kept = run_benchmarks({"record": lambda settings: [late]}, settings)
    assert not kept
    assert "NOT KEPT" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lop"], "unknown benchmark 'lop': choose from memory, loop"),
        (["loop", "--rounds", "0"], "--rounds must be positive"),
        (["loop", "--duration", "-1"], "--duration must be positive"),
    ],
)
def test_a_wrong_request_is_refused(words, message, capsys):
    assert main(["bench", *words]) == 2
    assert message in capsys.readouterr().err
