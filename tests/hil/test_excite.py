"""A scenario's rig is excited as any rig is; what the command says is what happened."""

from dataclasses import replace

import numpy as np
import pytest
from koop_msgs.msg import MeasuredState

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_commission.stages.bags import count_answers
from koop_commission.theta.limits import SAFETY
from koop_core.errors import LiveError
from koop_hil import report
from koop_hil.excite import record_excitation, rig_of
from koop_hil.run import run_here
from koop_hil.scenario import find, parse, read
from koop_hil.supervisor import Supervisor
from koop_tune.rig.rig_file import read as read_rig

pytestmark = pytest.mark.ros
TIME = 20.0  # [s] in which theta goes to the end of its range
SCALE = 3.0  # times real time: 600 states a second, which a commander on a busy machine answers


def scenario(tmp_path):
    return parse("rig", {"time_scale": 10, "plant": "paper"}, tmp_path)


def test_theta_moves_over_its_range_while_the_plant_is_recorded(tmp_path, monkeypatch):
    monkeypatch.setattr("koop_tune.excitation.survey.LISTEN", 8.0)
    given = read(find("rig-galloping"))
    faster = replace(given, setting=replace(given.setting, time_scale=SCALE))
    said = record_excitation(faster, tmp_path, TIME)
    assert "the 20 s of the rig file are over; theta is back at -2" in said
    rig = rig_of(faster, TIME)
    assert read_rig(tmp_path / "rig.yaml") == rig
    recorded = tmp_path / "part-1" / "bag"
    with BagReader(recorded) as bag:
        theta, state = (read_columns(bag, topic) for topic in ("/theta", "/state"))
        cost = read_columns(bag, "/cost")
        applied = read_columns(bag, "/ground_truth", ["theta_applied"])["theta_applied"]
    states, answered = count_answers(recorded)
    assert f"recorded {states} states, {answered} of them with a theta" in said
    known = np.isin(state["step"], theta["step"])[state["step"] >= theta["step"][0]]
    # at first who listens may not hear, the last ones were under way at the end
    assert known[round(SAFETY.matched * SCALE / 0.005) : int(0.9 * known.size)].mean() > 0.9
    assert state["step"][-1] * 0.005 >= TIME - 1.0
    between = (theta["step"] >= cost["step"][0]) & (theta["step"] <= cost["step"][-1])
    assert np.isin(theta["step"][between], cost["step"]).mean() > 0.9  # of 600 a second
    assert between.mean() > 0.3  # the lifter ends before the recorder
    # the commander may be late on a busy machine; a jump home would be 1 and more
    assert np.abs(np.diff(theta["theta"])).max() <= 0.2 * rig.theta_rate
    assert theta["theta"].min() < -3.0
    assert applied.min() < -3.0
    assert theta["theta"][-1] == applied[-1] == rig.theta_safe


def test_a_rig_that_ends_at_its_arguments_is_an_error_with_its_last_lines(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Nonsense/></CycloneDDS>")
    with pytest.raises(LiveError, match=r"plant ended with exit code 1:(.*\n)*.*DDSException"):
        record_excitation(scenario(tmp_path), tmp_path, 10.0)


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


def test_another_loop_on_the_domain_is_an_error_before_anything_starts(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    given = scenario(tmp_path)
    broken = replace(given, setting=replace(given.setting, plant="papier"))
    with pytest.raises(LiveError, match="another loop runs on ROS domain"):
        record_excitation(broken, tmp_path, 1000.0)
