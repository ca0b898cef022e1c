"""The pure parts of the harness: scenario files, faults, reports."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_hil import faults, installed
from koop_hil.faults import Channel
from koop_hil.processes import Processes
from koop_hil.scenario import (
    RIGS,
    find,
    parse,
    read,
)


def through(fault, messages, dt=0.005, seed=1):
    """Return (step, values) of what comes out of a channel."""
    channel = Channel(seed)
    channel.push(0.0, -1, [1.0, 2.0])  # a good one before the fault
    channel.pop(0.0)
    channel.fault = faults.parse(fault)
    out = []
    for k in range(messages):
        channel.push(k * dt, k, [float(k), 10.0])
        out += channel.pop(k * dt)
    return out + channel.pop(1e9)


def test_each_fault_does_what_its_name_says():
    assert through("ok", 3) == [(0, [0.0, 10.0]), (1, [1.0, 10.0]), (2, [2.0, 10.0])]
    assert through("off", 9) == []
    assert through("stuck", 2) == [(0, [1.0, 2.0]), (1, [1.0, 2.0])]
    assert through("stuck index=1", 2) == [(0, [0.0, 2.0]), (1, [1.0, 2.0])]
    assert through("wrong gain=2 bias=1 index=0", 2) == [(0, [1.0, 10.0]), (1, [3.0, 10.0])]
    assert [k for k, _ in through("slow every=3", 9)] == [1, 4, 7]
    assert all(math.isnan(v) for v in through("garbage kind=nan", 1)[0][1])
    assert through("garbage kind=inf", 1) == [(0, [math.inf, math.inf])]
    assert through("garbage kind=short", 1) == [(0, [0.0])]


def test_losses_and_duplicates_have_the_asked_share():
    assert 650 < len(through("intermittent loss=0.3", 1000)) < 750
    assert 1450 < len(through("intermittent duplicate=0.5", 1000)) < 1550


def test_a_delay_keeps_the_order_and_jitter_does_not():
    channel = Channel()
    channel.fault = faults.parse("delayed delay=0.1")
    channel.push(0.0, 0, [1.0])
    assert channel.pop(0.0999) == []
    assert channel.pop(0.1) == [(0, [1.0])]
    steps = [k for k, _ in through("delayed jitter=0.03", 200)]
    assert sorted(steps) == list(range(200))
    assert steps != sorted(steps)


@pytest.mark.parametrize(
    "text", ["", "broken", "delayed delay", "delayed speed=1", "delayed delay=x", "slow every=0",
             "garbage kind=odd", "intermittent loss=nan", "delayed delay=-1"],
)  # fmt: skip
def test_a_fault_that_is_none_is_refused(text):
    with pytest.raises(ConfigError):
        faults.parse(text)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "a scenario must be a mapping"),
        ({"duration": -1}, "duration = -1: must be"),
        ({"durations": 1}, "a scenario: unknown key 'durations': did you mean 'duration'"),
        ({"events": {"at": 1}}, "events must be a list"),
        ({"events": [{"at": 1}]}, "an event has one of inject, kill"),
        ({"events": [{"at": "x", "kill": "plant"}]}, "at: 'x' is not a number"),
        ({"events": [{"kill": "recorder"}]}, "kill: one of plant"),
        ({"events": [{"inject": {"state": False}}]}, "quote 'off' in YAML"),
        ({"events": [{"inject": {"cost": "off"}}]}, "into state or theta"),
        (
            {
                "events": [{"at": 1, "inject": {"state": "off"}}],
                "parameters": {"koopman_lifter": {"measured": "/rig/state:x[0]"}},
            },
            "and the lifter, not measured",
        ),
        ({"plant": "papier"}, "plant = 'papier': must be one of vdp_plant, galloping"),
        ({"remote": "recorder"}, "remote = 'recorder': must be one of"),
        ({"events": [{"cut": "link"}]}, "there is a link only if 'remote'"),
        ({"remote": "plant", "events": [{"cut": "plant"}]}, "cut: link, not 'plant'"),
        ({"limits": {"tail": 1}}, "limits: unknown key 'tail': known are tail_error"),
        ({"levels": {"relay_esc": "BAD"}}, "must be WARN, ERROR or STALE"),
        ({"rig_options": "--at 1:throttle=1"}, "rig_options: only of a rig"),
        ({"parameters": {"relay_esc": {"dt": 0.1}}}, "relay_esc: unknown parameter 'dt'"),
    ],
)
def test_a_scenario_that_means_nothing_is_refused(content, message):
    with pytest.raises(ConfigError, match=message):
        parse("name", content, Path("."))


def test_the_link_is_cut_for_a_time():
    content = {"remote": "plant", "events": [{"at": 20, "for": 8, "cut": "link"}]}
    scenario = parse("name", content, Path("."))
    assert scenario.setting.remote == "plant"
    assert str(scenario.events[0]) == "cut link for 8 s"


def test_a_rig_of_which_the_lifter_takes_one_field_measures_on_a_topic_of_its_own():
    lifter = {"measured": "/rig/state:x[0]"}
    scenario = parse("name", {"parameters": {"koopman_lifter": lifter}}, Path("."))
    assert scenario.sensor_topic == "rig/state"
    assert "rig/state" in scenario.topics


def test_a_rig_of_standard_messages_says_what_it_does_by_the_parameters(tmp_path):
    scenario = read(find("rig-jsbsim-gusts"))
    rig = Processes(tmp_path, scenario, None, None)._command("plant")[0]
    assert rig[:2] == ["jsbsim", "--until-eof"]
    assert {"--state=imu", "--theta=theta", "--truth"} <= set(rig)
    assert rig[-len(split := scenario.setting.rig_options.split()) :] == split
    assert scenario.dt == pytest.approx(1 / 120, rel=1e-4)
    best = scenario.setting.theta_star
    assert scenario.off(best * np.array([[1.0], [math.e]])) == pytest.approx([0.0, 1.0])  # in Np
    assert read(find("rig-paper")).off(np.array([[-3.0], [1.0]])) == pytest.approx([0.0, 4.0])


def test_the_rigs_that_a_scenario_may_name_are_those_of_the_program():
    done = subprocess.run(
        [sys.executable, installed("rigs") / "rig.py", "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name in RIGS:
        assert re.search(rf"^    {name}\b", done.stdout, re.MULTILINE)


def test_a_scenario_file_cannot_make_objects(tmp_path):
    file = tmp_path / "bad.yaml"
    file.write_text("description: !!python/object/apply:os.system ['true']\n")
    with pytest.raises(ConfigError, match=r"bad\.yaml: cannot be read as YAML"):
        read(file)


def test_a_rig_without_its_middleware_says_how_to_get_it(tmp_path):
    (tmp_path / "cyclonedds.py").write_text("raise ImportError('none here')")
    rig = installed("rigs") / "rig.py"
    done = subprocess.run(
        [sys.executable, rig, "galloping"], env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, "rig: none here: pip install cyclonedds\n")
