"""Recording to identify a model: what the command says is what happened."""

from dataclasses import replace

import numpy as np
import pytest
from koop_msgs.msg import MeasuredState

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_hil.excite import HOLD, excite
from koop_hil.scenario import parse
from koop_lab.errors import LiveError

pytestmark = pytest.mark.ros


def scenario(tmp_path):
    return parse("rig", {"time_scale": 10, "plant": "paper"}, tmp_path)


def test_theta_moves_over_its_range_while_the_rig_is_recorded(tmp_path):
    recorded = excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=2.2 * HOLD)
    with BagReader(recorded.bag) as bag:
        theta = read_columns(bag, "/theta", ["theta"])["theta"]
        state = read_columns(bag, "/state", ["step"])["step"]
        applied = read_columns(bag, "/ground_truth", ["theta_applied"])["theta_applied"]
    assert recorded.seconds == state.size * 0.005 > 1.1 * HOLD
    chosen = np.unique(theta)
    assert 2 <= chosen.size <= 3  # one a hold
    assert chosen.min() >= -4.0
    assert chosen.max() <= 3.0
    assert np.isin(chosen[:-1], applied).all()


def test_a_rig_that_cannot_start_is_an_error_though_another_loop_runs(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    given = scenario(tmp_path)
    broken = replace(given, setting=replace(given.setting, plant="papier"))
    with pytest.raises(LiveError, match=r"(?s)plant ended: .*invalid choice"):
        excite(broken, tmp_path, -4.0, 3.0, duration=10.0)


def test_another_loop_on_the_domain_is_an_error(tmp_path, probe):
    probe.node.create_publisher(MeasuredState, "state", 10)
    with pytest.raises(LiveError, match="2 publishers on 'state', 1 of this run"):
        excite(scenario(tmp_path), tmp_path, -4.0, 3.0, duration=1000.0)
