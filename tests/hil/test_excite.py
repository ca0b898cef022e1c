"""Recording to identify a model: what the command says is what happened."""

from dataclasses import replace

import numpy as np
import pytest
from koop_msgs.msg import MeasuredState

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_hil import report
from koop_hil.excite import count_answers, excite
from koop_hil.run import run_here
from koop_hil.scenario import find, parse, read
from koop_hil.supervisor import Supervisor
from koop_node.errors import LiveError

pytestmark = pytest.mark.ros
HOLD = 20.0  # [s] that theta stays; a rig would not settle, but nothing here looks at that


def scenario(tmp_path):
    return parse("rig", {"time_scale": 10, "plant": "paper"}, tmp_path)


@pytest.mark.parametrize(("name", "pace"), [("rig-paper", "scaled"), ("state-nan", "lockstep")])
def test_theta_moves_over_its_range_while_the_plant_is_recorded(tmp_path, name, pace, monkeypatch):
    monkeypatch.setattr("koop_hil.excite.HOLD", HOLD)
    given, duration = read(find(name)), 1.2 * HOLD
    faster = replace(given, setting=replace(given.setting, pace=pace, time_scale=8.0))
    recorded = excite(faster, tmp_path, -4.0, 3.0, duration)
    with BagReader(recorded) as bag:
        theta, state = (read_columns(bag, topic) for topic in ("/theta", "/state"))
        applied = read_columns(bag, "/ground_truth", ["theta_applied"])["theta_applied"]
    assert count_answers(recorded) == (state["step"].size, theta["step"].size)
    for topic in (state, theta):
        assert (np.diff(topic["step"].astype(int)) == 1).all()  # a command without gaps, too
        assert topic["step"][-1] * 0.005 >= duration - 0.1
    changes = np.flatnonzero(np.diff(theta["theta"])) + 1
    assert (theta["step"][changes] * 0.005).tolist() == [HOLD]
    assert theta["theta"].min() >= -4.0
    assert theta["theta"].max() <= 3.0
    assert np.isin(theta["theta"][changes - 1], applied).all()


def test_a_rig_that_cannot_start_is_an_error_though_another_loop_runs(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    given = scenario(tmp_path)
    broken = replace(given, setting=replace(given.setting, plant="papier"))
    with pytest.raises(LiveError, match="another loop runs on ROS domain"):
        excite(broken, tmp_path, -4.0, 3.0, duration=10.0)


def test_a_rig_that_ends_at_its_arguments_is_an_error_with_its_last_lines(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Nonsense/></CycloneDDS>")
    with pytest.raises(LiveError, match=r"plant ended with exit code 1:(.*\n)*.*DDSException"):
        excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=10.0)


@pytest.mark.parametrize("topic", ["theta", "ground_truth"])
def test_a_scenario_does_not_start_beside_another_publisher(tmp_path, probe, topic):
    probe.node.create_publisher(MeasuredState, topic, 10)
    verdict = run_here(scenario(tmp_path), tmp_path)
    assert "another loop runs on ROS domain" in verdict.failures[0]
    assert not (tmp_path / "bag").exists()
    assert report.line(verdict).split() == ["rig", "FAILED"]


def test_a_publisher_that_comes_later_fails_the_scenario(tmp_path, probe):
    given = scenario(tmp_path)
    long = replace(given, setting=replace(given.setting, duration=3000.0))
    shown = []

    def come(t, text):
        if not shown:
            shown.append(probe.node.create_publisher(MeasuredState, "state", 10))

    with pytest.raises(LiveError, match="2 publishers on 'state', 1 of this run"):
        Supervisor(long, tmp_path, come).run()


def test_a_recording_with_theta_for_a_part_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("koop_hil.excite.count_answers", lambda bag: (2000, 1100))
    with pytest.raises(LiveError, match="2000 states and a theta for 1100 of them were recorded"):
        excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=10.0)


def test_another_loop_on_the_domain_is_an_error(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    with pytest.raises(LiveError, match="another loop runs on ROS domain"):
        excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=1000.0)
