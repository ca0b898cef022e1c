"""The scenario files, run by pytest; `koop hil` runs the same files by hand.

By default two are run for a minute of simulated time, and only what must hold every time is
asserted: nothing crashes, the faults are reported, the run is recorded. Whether theta converges is
a matter of chance in one run (docs/hil.md); with KOOP_HIL=all every scenario is run and judged.
"""

import os
from dataclasses import replace

import pytest

from koop_lab.hil.command import find, run, scenario_files
from koop_lab.hil.scenario import Limits, read

NAMES = [path.stem for path in scenario_files()]
JUDGED = NAMES if os.environ.get("KOOP_HIL") == "all" else []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rig-other", "kill-lifter"])
def test_the_loop_survives_and_is_recorded(name, tmp_path):
    scenario = read(find(name))
    setting = replace(scenario.setting, duration=60.0)
    unlimited = Limits(tail_error=1e3)
    verdict = run(replace(scenario, setting=setting, limits=unlimited), tmp_path)
    assert verdict.passed, verdict.failures
    assert (tmp_path / "verdict.json").is_file()
    assert verdict.messages["/theta"] > 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", JUDGED)
def test_the_scenario_passes(name, tmp_path):
    verdict = run(read(find(name)), tmp_path)
    assert verdict.passed, verdict.failures


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_file_is_valid(name):
    assert read(find(name)).setting.description
