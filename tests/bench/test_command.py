"""`koop bench` runs what is named, and the error of one benchmark ends no other."""

from __future__ import annotations

import math
import re
import subprocess
from contextlib import nullcontext
from functools import partial
from importlib import import_module

import pytest

from koop_bench import guard
from koop_bench.command import BENCHMARKS, run_benchmarks
from koop_bench.figures import BenchFigure, BenchSettings
from koop_core.errors import KoopError
from koop_lab.cli.main import main


def fail(settings: BenchSettings, error: Exception) -> list[BenchFigure]:
    settings.show("before the end")
    raise error


def test_every_benchmark_is_a_module():
    for name in BENCHMARKS:
        assert import_module(f"koop_bench.{name}").run.__doc__


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KoopError("no more space"), "no more space\n"),
        (OSError(28, "no more space"), "[Errno 28] no more space\n"),
        (subprocess.TimeoutExpired("cc", 1.0), "Traceback"),
    ],
)
def test_one_that_fails_loses_no_other(error, told):
    lines: list[str] = []
    figure = BenchFigure("speed", "2 steps/s", 0.5, "C")
    settings = BenchSettings(None, None, lines.append)
    assert not run_benchmarks(
        {"bad": partial(fail, error=error), "good": lambda settings: [figure]}, settings
    )
    assert "| good | speed | 2 steps/s | 0.5 x C |" in lines[-1]
    text = "\n".join(lines)
    assert f"before the end\nfailed: {told}" in text
    assert re.findall(r"^(\w+): \w+$", text, re.MULTILINE) == ["bad", "good"]


def test_a_promise_that_is_not_kept_is_a_failure():
    lines: list[str] = []
    settings = BenchSettings(None, None, lines.append)
    late = BenchFigure("missing", "0.3 s", 1.5, "the limit", kept=False)
    assert not run_benchmarks({"record": lambda settings: [late]}, settings)
    assert "NOT KEPT" in lines[-1]


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


def test_a_sample_that_the_guard_never_answered_counts_as_answered_last(monkeypatch):
    monkeypatch.setattr(guard, "measure", lambda *_: [0.001] * 998 + [math.inf] * 2)
    monkeypatch.setattr(guard, "keep_busy", lambda wanted: nullcontext())
    figures = guard.run(BenchSettings(None, 1, lambda line: None))
    assert {figure.value for figure in figures} == {"inf ms"}
    assert not figures[1].kept
