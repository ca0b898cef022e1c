"""Results of units: kept, resumed after a stop, the same on a second run."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import dask.config
import pytest

from koop_core.config.parameter import ConfigError
from koop_lab.cli.main import main
from koop_study.experiments import stats
from koop_study.simulation.work import runs
from koop_study.workers import cluster, units
from koop_study.workers.cluster import WorkerLost, compute_all
from koop_study.workers.task import WORK
from koop_study.workers.units import Store, Unit
from koop_view.report.document import Column, Table

TINY = """
experiment: cases
title: Sensitivity
text: Small.
costs: {raw: {cost: raw}, lifted: {cost: lifted}}
tables:
  - name: sensitivity
    title: Constants
    parameters: [lifter.omega_h, lifter.omega_l, esc.tau_f]
    grid: [[5, 20], [0.1, 0.3], [3, 10]]
seeds: {first: 0, count: 2}
settings: {duration: 300, training.trajectories: 10, training.duration: 10}
"""

SHORT = {"cost": "raw", "duration": 100.0}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "sensitivity.yaml"
    path.write_text(TINY)
    return path


def arguments(file: Path, out: Path) -> list[str]:
    return ["study", str(file), "--out", str(out), "--processes", "1"]


def study(file: Path, out: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "koop_lab", *arguments(file, out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )


def outcome(out: Path) -> dict[str, bytes]:
    files = [*out.glob("tables/*.csv"), out / "report.html"]
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def results(out: Path) -> int:
    return len(list(out.glob("units/*.json")))


def wait_for(condition: Callable[[], bool], running: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + 120.0
    while not condition():
        assert running is None or running.poll() is None, running.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def children(pid: int) -> list[int]:
    threads = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for one in threads for child in (one / "children").read_text().split()]


def ended(pid: int) -> bool:
    try:
        return "State:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.mark.slow
def test_a_stopped_study_goes_on_and_a_second_run_gives_the_same_bytes(
    file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    one, other = tmp_path / "a", tmp_path / "b"
    killed = study(file, one)
    wait_for(lambda: results(one) >= 2, killed)
    workers = children(killed.pid)
    assert len(workers) >= 2  # and multiprocessing's tracker
    killed.kill()
    killed.communicate()
    wait_for(lambda: all(ended(worker) for worker in workers))  # they end with their parent
    kept = results(one)
    assert 2 <= kept < 16

    stopped = study(file, one)
    wait_for(lambda: results(one) > kept, stopped)
    os.killpg(stopped.pid, signal.SIGINT)  # as a terminal does, to the workers too
    text = stopped.communicate(timeout=240)[0]
    assert stopped.returncode == 130
    assert f"16 units of work, {kept} of them there already" in text
    assert "the same command resumes" in text
    assert "Traceback" not in text
    kept = results(one)
    assert kept < 16

    assert main(arguments(file, one)) == 0
    assert f"16 units of work, {kept} of them there already" in capfd.readouterr().err
    assert main(arguments(file, other)) == 0
    assert outcome(one) == outcome(other)
    assert outcome(one).keys() == {"report.html", "tables/sensitivity.csv"}


def test_workers_killed_again_and_again_end_the_study_with_an_error_and_keep_what_was_done(
    tmp_path: Path,
) -> None:
    store = Store(tmp_path)
    # the second one would take minutes
    units = [Unit("runs", {"settings": SHORT, "seeds": [*range(n)]}) for n in (1, 100_000)]

    def kill() -> None:
        wait_for(lambda: store.has(units[0]))
        for process in multiprocessing.active_children():
            process.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        pytest.raises(WorkerLost, match="too little memory"),
    ):
        compute_all(units, store, 1)
    killer.join()
    assert store.has(units[0])
    assert not store.has(units[1])
    wait_for(lambda: not multiprocessing.active_children())  # one may just be starting again


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Return a function that starts a part of a Dask cluster, which ends with the test."""
    with ExitStack() as stack:

        def process(part: str, *arguments: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *arguments]
            log = stack.enter_context((tmp_path / "log").open("ab"))
            started = stack.enter_context(subprocess.Popen(command, stdout=log, stderr=log))
            stack.callback(started.kill)
            return started

        yield process


def test_a_cluster_loses_nothing_with_a_killed_worker_and_gives_the_same_results(
    tmp_path: Path, start: Callable[..., subprocess.Popen[bytes]]
) -> None:
    file = tmp_path / "scheduler.json"
    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
                      "--scheduler-file", str(file))  # fmt: skip
    options = ("--scheduler-file", str(file), "--nthreads", "1", "--no-nanny", "--no-dashboard")
    worker, _ = (start("worker", *options) for _ in range(2))
    wait_for(lambda: file.exists() and file.read_text().endswith("}"))  # it is written in place
    store, address = Store(tmp_path / "units"), json.loads(file.read_text())["address"]
    settings = {**SHORT, "duration": 500.0}
    every = [Unit("runs", {"settings": settings, "seeds": [n, n + 1]}) for n in range(32)]
    units, further = every[:16], every[16:]

    def kill(process: subprocess.Popen[bytes], units: list[Unit], left: list[int]) -> None:
        wait_for(lambda: sum(map(store.has, units)) >= len(units) // 2)
        process.kill()
        left.append(sum(not store.has(unit) for unit in units))

    with ThreadPoolExecutor(1) as thread:
        left: list[int] = []
        killed = thread.submit(kill, worker, units, left)
        actual = compute_all(units, store, 1, address)
        killed.result()
        assert worker.wait() == -signal.SIGKILL
        assert left[0] > 1
        assert actual == [runs(**unit.arguments) for unit in units]
        again = re.findall("recomputed elsewhere: .*", (tmp_path / "log").read_text())
        assert sum(line.count("runs-") for line in again) <= left[0]  # at most what was not stored
        with pytest.raises(ValueError, match="has other code"):
            compute_all([replace(units[0], code="of another commit")], store, 1, address)
        thread.submit(kill, scheduler, further, left)
        with pytest.raises(WorkerLost, match="scheduler has gone"):
            compute_all(further, store, 1, address)
        assert any(map(store.has, further))


def test_where_no_scheduler_is_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with (
        pytest.raises(ConfigError, match=f"127.0.0.1:{port}: no Dask scheduler there"),
        cluster.on_cluster(f"tcp://127.0.0.1:{port}"),
    ):
        pass


def test_what_the_store_has_is_not_computed_again(tmp_path: Path) -> None:
    store, unit = Store(tmp_path), Unit("runs", {"no": "argument of it"})
    store.save(unit, [{"iae": 1.5}])
    assert compute_all([unit, unit], store, 1) == [[{"iae": 1.5}], [{"iae": 1.5}]]


def test_another_argument_is_another_unit() -> None:
    one = Unit("runs", {"settings": {"esc.dwell": 5}, "seeds": [1]})
    assert one.key == Unit("runs", {"seeds": [1], "settings": {"esc.dwell": 5}}).key
    assert one.key != Unit("runs", {"settings": {"esc.dwell": 5}, "seeds": [2]}).key
    assert one.key != Unit("settled", one.arguments).key


def test_comments_docstrings_and_line_breaks_do_not_change_what_code_means() -> None:
    plain = 'def f(x):\n    """One."""\n    return x + 1\n'
    for same in (
        'def f(x):\n    """Two."""\n    return x + 1\n',
        '"""Module."""\n\n\ndef f(x):\n    return x + 1\n',
        'def f(x):\n    """One."""\n    # why\n    return (\n        x + 1\n    )\n',
    ):
        assert units.meaning(same) == units.meaning(plain)
    field = "class A:\n    x: int = 1\n"
    assert units.meaning(f'{field}    """Above 0."""\n') == units.meaning(field)
    for other in ("x + 2", "x - 1", "1 + x", "'x + 1'"):
        assert units.meaning(plain.replace("x + 1", other)) != units.meaning(plain)


def test_what_decides_results_imports_nothing_that_the_fingerprint_leaves_out() -> None:
    # what a fresh interpreter has loaded after the works' import is what can decide results
    modules = sorted({name.partition(":")[0] for name in WORK.values()})
    script = (
        f"import sys, {', '.join(modules)}\n"
        "for name, module in sys.modules.items():\n"
        "    if name.startswith(('koop', 'vdp_plant', 'relay_esc')) and module.__file__:\n"
        "        print(name)\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    # bags are read there, but the study's recordings never were in one
    allowed = (*units.PACKAGES, "koop_bag", "koop_study")
    loaded = [name for name in run.stdout.split() if name != "koop_study"]
    assert len(loaded) > 50
    for name in loaded:
        inside = any(name == package or name.startswith(f"{package}.") for package in allowed[:-1])
        assert inside or name in ("koop_study.workers", "koop_study.experiments"), name


@pytest.fixture(scope="module")
def meanings() -> dict[str, str]:
    """Return the meaning of every module that decides results."""
    return {name: units.meaning(text) for name, text in units.sources(units.PACKAGES).items()}


@pytest.mark.parametrize("package", units.PACKAGES)
def test_a_changed_line_in_any_package_that_decides_results_changes_the_key(
    package: str, meanings: dict[str, str]
) -> None:
    unit = Unit("runs", {"seeds": [1]})
    assert unit.code == units.digest_of(meanings)
    texts = units.sources([package])
    assert len(texts) > 1
    for name in (min(texts), max(texts)):
        changed = units.meaning(texts[name] + "\nADDED = 1\n")
        code = units.digest_of({**meanings, name: changed})
        assert replace(unit, code=code).key != unit.key


def test_a_new_module_changes_the_key_and_one_that_knows_ros_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "invented"
    (package / "deep").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    before = units.digest_of(units.sources(["invented"]))
    (package / "node.py").write_text("import rclpy\n")
    assert units.digest_of(units.sources(["invented"])) == before
    (package / "deep" / "new.py").write_text("A = 1\n")
    assert units.digest_of(units.sources(["invented"])) != before


def test_results_come_back_to_the_last_bit(tmp_path: Path) -> None:
    store, unit = Store(tmp_path), Unit("runs", {})
    store.save(unit, [0.1 + 0.2, float("inf"), None])
    assert store.load(unit) == [0.1 + 0.2, float("inf"), None]


def test_quantiles_are_values_that_occurred_also_beside_infinity() -> None:
    inf = float("inf")
    assert stats.quantile([3.0, 1.0, inf, 2.0], 0.5) == 2.0
    assert stats.quantile([3.0, 1.0, inf, 2.0], 0.9) == inf
    assert stats.quantile([1.0], 0.1) == 1.0
    assert stats.quantile(list(range(1, 11)), 0.9) == 9


def test_a_win_needs_the_smaller_value_at_the_same_seed() -> None:
    ours = [{"iae": 1.0}, {"iae": 5.0}, {"iae": 2.0}, {"iae": float("inf")}]
    theirs = [{"iae": 2.0}, {"iae": 4.0}, {"iae": 2.0}, {"iae": float("inf")}]
    assert stats.win_rate(ours, theirs) == 25.0


def test_csv_has_ten_digits_and_nothing_where_there_is_no_value() -> None:
    table = Table("t", "T", (Column("a", "A"), Column("b", "B")), [("x", 1 / 3), ("y", None)])
    assert table.csv() == "a,b\nx,0.3333333333\ny,\n"
    assert json.loads(json.dumps(table.texts())) == [["x", "0.3333"], ["y", "–"]]
