"""Recording to identify a model: what the command says is what happened."""

from dataclasses import replace

import numpy as np
import pytest
from koop_msgs.msg import MeasuredState

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_hil.excite import HOLD, excite
from koop_hil.scenario import find, parse, read
from koop_node.errors import LiveError

pytestmark = pytest.mark.ros


def scenario(tmp_path):
    return parse("rig", {"time_scale": 10, "plant": "paper"}, tmp_path)


@pytest.mark.parametrize(("name", "pace"), [("rig-paper", "scaled"), ("state-nan", "lockstep")])
def test_theta_moves_over_its_range_while_the_plant_is_recorded(tmp_path, name, pace):
    given, duration = read(find(name)), 1.2 * HOLD
    faster = replace(given, setting=replace(given.setting, pace=pace, time_scale=8.0))
    recorded = excite(faster, tmp_path, -4.0, 3.0, duration)
    with BagReader(recorded) as bag:
        theta, state = (read_columns(bag, topic) for topic in ("/theta", "/state"))
        applied = read_columns(bag, "/ground_truth", ["theta_applied"])["theta_applied"]
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


def test_another_loop_on_the_domain_is_an_error(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    with pytest.raises(LiveError, match="another loop runs on ROS domain"):
        excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=1000.0)
