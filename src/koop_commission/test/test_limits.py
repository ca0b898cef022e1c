"""Theta keeps its limits and its rate, and returns to theta_safe for good."""

import json
import math
from dataclasses import replace

import pytest

from koop_commission.theta.assignment import Assignment
from koop_commission.theta.limits import (
    LimitedTheta,
    SafetySettings,
    compute_return_time,
    describe_violation,
)
from koop_core.config.parameter import ConfigError
from koop_guard.note import find_theta
from koop_tune.rig.rig_file import RigFile

DT = 0.01
RIG = RigFile(
    "/a:x,y", "a/msg/A", "/b:z", "std_msgs/msg/Float64", DT, -1.0, 3.0, 0.5, 2.0, 0.5,
    channel_max=(5.0, 6.0),
)  # fmt: skip


def test_theta_keeps_its_limits_and_its_rate_whatever_is_asked():
    theta = LimitedTheta(RIG, 2.0, 2.0).aim(99.0)
    assert theta.target == RIG.theta_max
    assert theta.advance(1e9).theta == pytest.approx(2.0 + 2 * DT * 0.5)  # however late
    assert theta.advance(-1.0).theta == 2.0
    assert theta.aim(math.nan) == theta
    for _ in range(1000):
        before, theta = theta, theta.advance(DT)
        assert abs(theta.theta - before.theta) <= 0.5 * DT + 1e-12
    assert theta.arrived
    assert not theta.safe


def test_the_first_reason_to_return_stays_and_no_target_is_followed_any_more():
    theta = LimitedTheta(RIG, 2.0, 3.0).give_up("first").give_up("second").aim(3.0)
    assert (theta.reason, theta.target) == ("first", RIG.theta_safe)
    steps = 0
    while not theta.safe:
        theta, steps = theta.advance(DT), steps + 1
    assert theta.theta == RIG.theta_safe
    assert steps * DT == pytest.approx((2.0 - 0.5) / 0.5, abs=2 * DT)


def test_a_late_message_moves_theta_by_as_much_as_the_settings_allow():
    patient = SafetySettings(late_periods=10.0)
    assert LimitedTheta(RIG, 0.0, 3.0).advance(1.0, patient).theta == pytest.approx(10 * DT * 0.5)
    with pytest.raises(ConfigError, match="late_periods"):
        SafetySettings(late_periods=0.0)


def test_a_limit_of_a_channel_is_named():
    rig = replace(RIG, channel_min=(-1.0, -2.0))
    assert describe_violation(rig, [4.9, 5.9]) == ""
    assert describe_violation(rig, [4.9, 6.1]) == "y = 6.1 is beyond its limit 6"
    assert describe_violation(rig, [-1.5, 0.0]) == "x = -1.5 is beyond its limit -1"
    assert describe_violation(replace(RIG, channel_max=()), [1e9, -1e9]) == ""


def test_times_follow_the_pace_of_the_rig():
    fast = replace(RIG, pace=4.0)
    assert compute_return_time(RIG, 2.0) == pytest.approx(3.0)
    assert compute_return_time(fast, 2.0) == pytest.approx(0.75)
    slow = replace(RIG, dt=0.5)
    settings = SafetySettings()
    assert settings.silence(RIG) == 1.0  # a busy machine needs that
    assert settings.silence(slow) == pytest.approx(10.0)
    assert settings.silence(replace(slow, pace=4.0)) == pytest.approx(2.5)


def test_an_assignment_is_read_as_it_was_written():
    rig = replace(RIG, channel_min=(-1.0, -2.0))
    assignment = Assignment(rig, 1.5, "/state:x[0]", "koop_msgs/msg/MeasuredState", 1, "n", "/c")
    assert Assignment.from_json(json.loads(json.dumps(assignment.as_json()))) == assignment


def test_theta_is_where_it_was_left_unless_the_rig_was_restarted(tmp_path):
    note = tmp_path / "note"
    assert find_theta(None, RIG, ["a"]) == (RIG.theta_start, "")
    assert find_theta(note, RIG, ["a"]) == (RIG.theta_start, "")
    note.write_text("0.75 a b\n")
    assert find_theta(note, RIG, ["b"]) == (0.75, "")
    assert find_theta(note, RIG, []) == (0.75, "")  # not discovered yet
    theta, remark = find_theta(note, RIG, ["c"])
    assert theta == RIG.theta_start
    assert "restarted since theta was left at 0.75: assuming theta_start = 2" in remark
    for torn in ("", "abc", "9.0 a"):  # the last is beyond the limits
        note.write_text(torn)
        assert find_theta(note, RIG, ["a"]) == (RIG.theta_start, "")
