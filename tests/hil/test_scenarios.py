"""The scenario files, run and judged by pytest; `koop hil` runs the same files by hand.

By default a rig and a fault, shortened; KOOP_HIL names scenarios or files that are run as they are,
and `all` is every scenario:

    KOOP_HIL=all ./koop test tests/hil/test_scenarios.py --junitxml=hil.xml
"""

import json
import os
import re
from dataclasses import replace

import pytest
from koop_msgs.msg import MeasuredState

from koop_core.errors import LiveError
from koop_hil import supervisor
from koop_hil.run import run, run_here
from koop_hil.scenario import find, parse, read, shipped

NAMES = [path.stem for path in shipped()]
FIGURES = ("tail_error", "max_error", "time_out_of_tolerance", "unrecorded")


def shortened(name, events=(), **setting):
    """Return a scenario with another setting, its events at other times."""
    scenario = read(find(name))
    times = [{"at": begin, "lasts": lasts} for begin, lasts in events]
    events = tuple(replace(e, **time) for e, time in zip(scenario.events, times, strict=True))
    return replace(scenario, setting=replace(scenario.setting, **setting), events=events)


def judged():
    """Return the scenarios to run."""
    chosen = os.environ.get("KOOP_HIL", "").split()
    if chosen:
        return [read(find(name)) for name in (NAMES if chosen == ["all"] else chosen)]
    # theta begins 1 from the optimum: one that does not move fails
    return [shortened("kill-lifter", [(4.0, 4.0)], duration=64.0, time_scale=2.0)]


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("scenario", judged(), ids=lambda scenario: scenario.name)
def test_the_scenario_passes(scenario, tmp_path, record_property):
    verdict = run(scenario, tmp_path)
    if verdict.skipped:
        pytest.skip(verdict.skipped)
    for figure in FIGURES:
        record_property(figure, getattr(verdict, figure))
    assert verdict.passed, verdict.failures
    assert json.loads((tmp_path / "verdict.json").read_text())["passed"]


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_file_is_valid(name):
    assert read(find(name)).setting.description


def paper_rig(tmp_path, **content):
    """Return a scenario of the paper's rig, without events."""
    return parse("rig", {"plant": "paper", **content}, tmp_path)


@pytest.mark.ros
def test_a_rig_that_ends_at_once_fails_the_scenario_with_its_last_lines(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Nonsense/></CycloneDDS>")
    (failure,) = run_here(paper_rig(tmp_path), tmp_path).failures
    assert re.search(r"plant ended with exit code 1:(.*\n)*.*DDSException", failure)


@pytest.mark.ros
def test_a_scenario_does_not_start_beside_another_publisher(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "ground_truth", 10)
    verdict = run_here(paper_rig(tmp_path), tmp_path)
    assert "another loop runs on ROS domain" in verdict.failures[0]
    assert not (tmp_path / "bag").exists()
    assert str(verdict).split() == ["rig", "FAILED"]


@pytest.mark.ros
def test_a_publisher_that_comes_later_fails_the_scenario(tmp_path, probe):
    shown = []

    def come(t, text):
        if not shown:
            shown.append(probe.node.create_publisher(MeasuredState, "state", 10))

    with pytest.raises(LiveError, match="2 publishers on 'state', 1 of this run"):
        supervisor.run(paper_rig(tmp_path, duration=3000.0), tmp_path, come)
