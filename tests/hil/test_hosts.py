"""Two hosts on one machine: the link between them is cut, and nothing of them stays behind."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from waiting import wait

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_hil import installed
from koop_hil.command import main
from koop_hil.hosts import HostsError, entrance
from koop_hil.run import run
from koop_hil.scenario import find, read

CUT = 8.0  # [s] of simulated time in the scenario


@pytest.fixture
def two_hosts():
    """Skip the test where two hosts cannot be made."""
    try:
        entrance()
    except HostsError as error:
        pytest.skip(str(error))


@pytest.mark.ros
@pytest.mark.slow
def test_the_plant_runs_on_while_the_link_is_cut_and_no_step_is_lost(two_hosts, tmp_path):
    scenario = read(find("link-cut"))
    setting = replace(scenario.setting, duration=28.0)
    events = tuple(replace(event, at=4.0) for event in scenario.events)
    limits = replace(scenario.limits, tail_error=1e3)  # converging takes longer than this
    verdict = run(replace(scenario, setting=setting, events=events, limits=limits), tmp_path)
    assert verdict.passed, verdict.failures
    with BagReader(tmp_path / "bag") as bag:
        for topic in ("state", "ground_truth"):
            steps = read_columns(bag, f"/{topic}", ["step"])["step"]
            assert set(np.diff(steps.astype(int))) == {1}, topic
        applied = read_columns(bag, "/ground_truth", ["theta_applied[0]"])["theta_applied[0]"]
    # Longest time without a change: all of the cut, up to a second for a busy machine. A publisher
    # that waits for a lost host would stop the plant instead, and its time with it.
    changes = np.flatnonzero(np.diff(applied))
    assert np.diff(changes).max() * 0.005 > CUT - 1.0 * setting.time_scale
    assert changes[-1] > applied.size - 400  # and theta moved again, up to the last 2 s


def processes_with(mark):
    """Return the processes in whose environment a mark was set."""
    actual = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes():
                actual.append(folder)
        except OSError:  # ended meanwhile, or another user's
            continue
    return actual


@pytest.mark.ros
def test_a_rig_ends_when_its_stdin_is_closed():
    rig = subprocess.Popen(
        [sys.executable, installed("rigs") / "rig.py", "paper", "--until-eof"],
        stdin=subprocess.PIPE,
    )
    rig.communicate()
    assert rig.returncode == 0


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_nothing_stays_behind_however_a_run_ends(two_hosts, tmp_path, number):
    mark = f"KOOP_TEST_MARK={tmp_path}"
    command = [sys.executable, "-m", "koop_lab", "hil", "two-hosts", "--out", tmp_path / "out"]
    environment = {**os.environ, **dict([mark.split("=")])}
    koop = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    log = tmp_path / "out" / "two-hosts" / "logs" / "plant.log"
    wait(lambda: log.is_file(), "the plant to start")

    def networks():
        with suppress(FileNotFoundError):  # ended meanwhile
            return {os.readlink(folder / "ns" / "net") for folder in processes_with(mark)}

    wait(lambda: len(networks() or ()) == 4, "two hosts, their link and this machine")
    koop.send_signal(number)
    koop.wait()
    wait(lambda: not processes_with(mark), "all processes to end")


def test_where_two_hosts_cannot_be_made_the_scenario_is_skipped(monkeypatch, tmp_path, capsys):
    unshare = tmp_path / "unshare"
    unshare.write_text("#!/bin/sh\nexit 1\n")  # every way in is refused
    unshare.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert main(arguments("link-cut", "--out", str(tmp_path / "out"))) == 0
    printed = capsys.readouterr().out
    assert "link-cut                 skipped: two hosts on one machine need" in printed
    assert "0 passed, 0 failed, 1 skipped" in printed


def test_a_missing_tool_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(HostsError, match=r"need 'ip' \(iproute2\)"):
        entrance()


def arguments(*words):
    """Return what the command line gives the command."""
    from koop_lab.cli.main import parser

    return parser().parse_args(["hil", *words])
