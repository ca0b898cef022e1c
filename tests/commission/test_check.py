"""``koop check`` on a live rig: a fit one, and a user's mistakes."""

import random
import re
from dataclasses import replace

import numpy as np
import pytest
from commission_rig import RIG
from std_msgs.msg import Float64, Float64MultiArray

from koop_commission.fitness.fitness import BAD
from koop_commission.fitness.settings import CheckSettings
from koop_commission.stages.check import check_rig

pytestmark = pytest.mark.ros


def rows_of(rig, moves=True, listen=1.0):
    settings = CheckSettings(listen=listen)
    rows = list(check_rig(rig, moves, rng=random.Random(0), settings=settings))
    assert len({str(row).count("\n") for row in rows}) == 1  # a line each
    return {row.name: row for row in rows}, [row.name for row in rows if row.level == BAD]


def test_a_fit_rig_reacts_and_theta_ends_at_its_safe_value(fast_rig):
    rows, bad = rows_of(RIG)
    assert bad == [], [rows[name].text for name in bad]
    # on a busy machine a late one is taken for a lost one now and then
    assert re.search(r"lost (none|[1-5] .*), no stamps: counted by arrival", rows["arrival"].text)
    assert "strongest at 20 Hz" in rows["spectrum"].text
    assert "reaches the rig with 97" in rows["theta"].text
    assert fast_rig.theta == RIG.theta_safe
    times, theta = np.array(fast_rig.moved).T
    assert RIG.theta_min <= theta.min()
    assert theta.max() <= RIG.theta_max
    # within the rate: over a time longer than the messages may be late
    for i, j in zip(range(0, theta.size - 60, 20), range(60, theta.size, 20), strict=False):
        assert abs(theta[j] - theta[i]) <= RIG.theta_rate * (times[j] - times[i] + 0.15)


def test_a_mistake_of_the_user_is_a_finding(fast_rig, probe):
    long = 3.5  # [s] in which any publisher is discovered
    rows, bad = rows_of(
        replace(RIG, measured="/slow:data[0]", channel_max=()), moves=False, listen=long
    )
    assert bad == ["graph"]
    assert "/slow has no publisher: is the rig running" in rows["graph"].text
    assert "/fast (std_msgs/msg/Float64MultiArray)" in rows["graph"].text
    rows, bad = rows_of(replace(RIG, command="/slow/knob:data"), moves=False, listen=long)
    assert "command: /slow/knob has no subscriber: is the rig running" in rows["graph"].text
    other = probe.node.create_publisher(Float64, "/fast", 10)
    rows, bad = rows_of(RIG, moves=False, listen=long)
    assert bad in (["graph"], ["arrival"])  # by when the second publisher is discovered
    texts = {
        "graph": "has several message types: std_msgs/msg/Float64, std_msgs/msg/Float64MultiArray",
        "arrival": "is published by",
    }
    assert f"/fast {texts[bad[0]]}" in rows[bad[0]].text
    probe.node.destroy_publisher(other)
    other = probe.node.create_publisher(Float64MultiArray, "/state", 10)
    state = replace(RIG, measured="/state:data[0]", channel_max=())
    rows, bad = rows_of(state, moves=False, listen=long)
    assert bad == ["graph"]
    assert "/state is std_msgs/msg/Float64MultiArray, for the lifter it is" in rows["graph"].text
    probe.node.destroy_publisher(other)
    second = probe.node.create_publisher(Float64MultiArray, "/fast", 10)
    rows, bad = rows_of(RIG, moves=False, listen=long)
    assert bad == ["arrival"]
    assert re.fullmatch(
        r"/fast is published by (/probe and /fast_rig|/fast_rig and /probe): stop all but .*",
        rows["arrival"].text,
    )
    probe.node.destroy_publisher(second)
    probe.node.create_publisher(Float64, "/fast/knob", 10)
    rows, bad = rows_of(replace(RIG, dt=0.01, channel_max=(8.0, 0.1)), listen=long)
    assert {"command", "arrival", "channel"} <= set(bad)
    assert rows["command"].text == "/fast/knob is commanded by /probe: stop that"
    assert "dt = 0.01: dt is wrong" in rows["arrival"].text
    assert "beyond its limit 0.1 before theta moves" in rows["channel"].text
    assert rows["theta"].text.startswith("was not moved")
    assert not fast_rig.moved
