"""``koop check`` on a live rig: a fit one, and a user's mistakes."""

import os
import random
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commission_rig import RIG
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64, Float64MultiArray, Int16MultiArray, Int32
from unique_identifier_msgs.msg import UUID
from waiting import TIMEOUT, wait

from koop_commission.fitness.fitness import BAD, NOTE
from koop_commission.fitness.settings import CheckSettings
from koop_commission.rig.graph import describe_rest
from koop_commission.stages.check import check_rig
from koop_core.config.fields import parse_field, read_field, write_field
from koop_core.config.parameter import ConfigError
from koop_core.stream.report import GHOST

pytestmark = pytest.mark.ros


def rows_of(rig, moves=True, ask=lambda *question: False, **settings):
    settings = CheckSettings(**{"listen": 1.0, **settings})
    for _ in range(3):
        rows = list(check_rig(rig, moves, rng=random.Random(0), settings=settings, ask=ask))
        assert len({str(row).count("\n") for row in rows}) == 1  # a line each
        bad = [row.name for row in rows if row.level == BAD]
        # else a busy machine: the rig was not on time, or silent
        if not moves or bad not in (["arrival"], ["theta"]):
            break
    return {row.name: row for row in rows}, bad


def silences_of(rig):
    """Return for how long nobody commanded theta, if for two seconds, by theta but theta_safe."""
    return {
        round(theta, 3): later - earlier
        for (earlier, theta), (later, _), (_, samples) in zip(
            rig.moved, rig.moved[1:], rig.silences, strict=False
        )
        if samples * RIG.dt > 2.0 and theta != RIG.theta_safe
    }


def test_a_fit_rig_reacts_and_theta_ends_at_its_safe_value(fast_rig, capfd):
    rows, bad = rows_of(RIG)
    *_, said = capfd.readouterr().out.splitlines()
    assert re.match(r" {6}moving theta between 1\.5 and 0\.75, at most \d+ s; Ctrl-C ends it", said)
    assert bad == [], [rows[name].text for name in bad]
    # on a busy machine a late one is taken for a lost one now and then
    assert re.search(r"lost (none|[1-5] .*), no stamps: counted by arrival", rows["arrival"].text)
    strongest = re.search(r"strongest at ([\d.]+) Hz", rows["spectrum"].text)
    assert strongest
    assert float(strongest[1]) == pytest.approx(20.0, rel=0.01)  # without stamps
    assert "reaches the rig with 97" in rows["theta"].text
    assert rows["time-out"].text.startswith("of the rig was not tested")  # nobody said yes
    assert silences_of(fast_rig) == {}
    assert fast_rig.theta == RIG.theta_safe
    times, theta = np.array(fast_rig.moved).T
    assert RIG.theta_min <= theta.min()
    assert theta.max() <= RIG.theta_max
    # within the rate: over a time longer than the messages may be late
    for i, j in zip(range(0, theta.size - 60, 20), range(60, theta.size, 20), strict=False):
        assert abs(theta[j] - theta[i]) <= RIG.theta_rate * (times[j] - times[i] + 0.15)


def test_where_a_step_changes_nothing_theta_goes_farther(fast_rig, capfd):
    """The optimum, 0.8, lies in the middle of the first step."""
    for _ in range(3):
        fast_rig.theta = 0.425
        rows, bad = rows_of(replace(RIG, theta_start=0.425))
        assert bad == [], [rows[name].text for name in bad]
        said = capfd.readouterr().out
        moves = re.findall(r"( |farther: )moving theta between (\S+) and (\S+),", said)
        if len(moves) > 1:
            break  # else a busy machine: the first step's blocks differed by chance
    assert moves[-2:] == [(" ", "0.425", "1.175"), ("farther: ", "0.425", "1.925")]
    assert "theta from 0.425 to 1.925" in rows["theta"].text


@pytest.mark.parametrize("time_out", [2.0, None])
def test_a_time_out_of_the_rig_is_looked_for_where_the_user_says_yes(fast_rig, probe, time_out):
    fast_rig.time_out = time_out
    asked, signs = [], probe.collect(Float64MultiArray, "/koop_guard/target")

    def ask(question, wait_until):
        asked.append(question)
        count = len(signs)  # of life, which the guard waits for
        wait_until(lambda: probe.executor.spin_once(timeout_sec=0.0) or len(signs) > count + 1)
        return True

    silence = 6.0 if time_out is None else 40.0  # [s]; the test ends once a time-out shows
    rows, _ = rows_of(RIG, ask=ask, silence=silence)
    assert asked, rows  # not asked where anything is BAD
    assert f"up to {silence:g} s without a guard" in asked[-1]
    text = rows["time-out"].text
    ((theta, silent),) = silences_of(fast_rig).items()
    assert abs(theta - RIG.theta_safe) == pytest.approx(0.25 * RIG.span)
    assert fast_rig.theta == RIG.theta_safe
    assert fast_rig.moved[-1][1] == RIG.theta_safe
    if time_out is None:
        assert silence - 1.0 < silent < silence + 12.0  # heard late, and late to end
        assert re.search(r"as at theta = \S+: no time-out, or a longer one", text)
    else:
        seconds = float(re.search(r"within (\S+) s without a command the rig oscillates", text)[1])
        assert 2.0 < seconds < silence  # at once, but on a busy machine
        assert silent < silence


def test_theta_returns_though_the_test_of_the_time_out_is_killed(fast_rig, tmp_path):
    code = (
        "from commission_rig import RIG\n"
        "from koop_commission.fitness.settings import CheckSettings\n"
        "from koop_commission.stages.check import check_rig\n"
        "settings = CheckSettings(listen=1.0, silence=8.0)\n"
        "list(check_rig(RIG, settings=settings, ask=lambda *question: True))\n"
    )
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}

    def start():
        with (tmp_path / "log").open("ab") as log:
            return subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=log)

    def silent():
        nonlocal check
        if check.poll() is not None:  # the rig was silent, on a busy machine
            check = start()
        return fast_rig.theta != RIG.theta_safe and fast_rig.age * RIG.dt > 3.0

    check = start()
    try:
        wait(lambda: fast_rig.moved and silent(), "silence", seconds=2.0 * TIMEOUT)
    finally:
        check.kill()
        check.wait()
    wait(lambda: fast_rig.theta == RIG.theta_safe, "theta to return")
    assert len(silences_of(fast_rig)) == 1
    assert max(silences_of(fast_rig).values()) < 16.0  # 8 s, and those of a busy machine


@pytest.mark.parametrize(
    ("message", "field"), [(Int32(), "data"), (Int16MultiArray(), "data[1]"), (UUID(), "uuid[3]")]
)
def test_theta_is_rounded_where_the_command_takes_whole_numbers_and_that_is_said(message, field):
    for value, whole in ((2.9999999, 3), (0.6, 1), (0.4, 0), (2.0, 2)):
        write_field(parse_field(field), message, value)
        sent = deserialize_message(serialize_message(message), type(message))
        assert read_field(parse_field(field), sent) == whole
    rig = replace(RIG, command=f"/fast/knob:{field}")
    kinds = [f"{type(message).__module__.partition('.')[0]}/msg/{type(message).__name__}"]
    said = f"/fast/knob: {field} takes whole numbers: theta is rounded, set limits that are"
    assert describe_rest(rig, kinds) == said
    assert describe_rest(RIG, ["std_msgs/msg/Float64"]) == ""


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
    for _ in range(5):
        with suppress(ConfigError):  # where the rig is discovered later, the type is the other's
            rows, bad = rows_of(RIG, moves=False, listen=long)
            break
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
    probe.node.create_subscription(Float64MultiArray, "/fast/second", lambda _: None, 10)
    rows, bad = rows_of(replace(RIG, command="/fast/second:data[1]"), moves=False, listen=long)
    assert (bad, rows["command"].level) == ([], NOTE)
    assert "/fast/second is always sent with data[0] = 0: is that safe?" in rows["command"].text
    second = probe.node.create_publisher(Float64MultiArray, "/fast", 10)
    rows, bad = rows_of(RIG, moves=False, listen=long)
    assert bad == ["arrival"]
    assert re.fullmatch(
        r"/fast is published by (/probe and /fast_rig|/fast_rig and /probe): stop all but .*",
        rows["arrival"].text,
    )
    probe.node.destroy_publisher(second)
    probe.node.create_publisher(Float64, "/fast/knob", 10)
    rows, bad = rows_of(replace(RIG, dt=0.02, channel_max=(8.0, 0.1)), listen=long)
    assert {"command", "arrival", "channel"} <= set(bad)
    text = f"/fast/knob is commanded by /probe: stop that ({GHOST})"
    assert rows["command"].text == text
    assert "dt = 0.02: dt is wrong" in rows["arrival"].text
    assert "beyond its limit 0.1 before theta moves" in rows["channel"].text
    assert rows["theta"].text.startswith("was not moved")
    assert not fast_rig.moved
