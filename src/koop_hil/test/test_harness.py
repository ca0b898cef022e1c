"""The pure parts of the harness: scenario files and rigs."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_hil import installed
from koop_hil.processes import Processes
from koop_hil.scenario import (
    RIGS,
    find,
    parse,
    read,
)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "a scenario must be a mapping"),
        ({"duration": -1}, "duration = -1: must be"),
        ({"durations": 1}, "a scenario: unknown key 'durations': did you mean 'duration'"),
        ({"plant": "papier"}, "plant = 'papier': must be one of vdp_plant, galloping"),
        ({"cut_for": 8}, "cut_for: there is a link only with two_hosts: true"),
        ({"two_hosts": True, "cut_at": 52, "cut_for": 8}, "cut_for: the run is over before"),
        ({"two_hosts": "plant"}, "two_hosts: expected bool, got 'plant'"),
        ({"events": []}, "a scenario: unknown key 'events'"),
        ({"limits": {"tail": 1}}, "limits: unknown key 'tail': known are tail_error"),
        ({"levels": {"relay_esc": "BAD"}}, "must be WARN, ERROR or STALE"),
        ({"rig_options": "--at 1:throttle=1"}, "rig_options: only of a rig"),
        ({"parameters": {"relay_esc": {"dt": 0.1}}}, "relay_esc: unknown parameter 'dt'"),
    ],
)
def test_a_scenario_that_means_nothing_is_refused(content, message):
    with pytest.raises(ConfigError, match=message):
        parse("name", content, Path("."))


def test_a_rig_of_which_the_lifter_takes_one_field_measures_on_a_topic_of_its_own():
    lifter = {"measured": "/rig/state:x[0]"}
    scenario = parse("name", {"parameters": {"koopman_lifter": lifter}}, Path("."))
    assert scenario.sensor_topic == "rig/state"
    assert "rig/state" in scenario.topics


def test_a_rig_of_standard_messages_says_what_it_does_by_the_parameters(tmp_path):
    scenario = read(find("rig-jsbsim-gusts"))
    rig = Processes(tmp_path, scenario)._command("plant")[0]
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
