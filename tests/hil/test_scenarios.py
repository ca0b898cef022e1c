"""The scenario files, run by pytest; `koop hil` runs the same files by hand.

By default only two, chosen to reach a foreign DDS and a killed node; with KOOP_HIL=all every one.
"""

import os

import pytest

from koop_lab.hil.command import find, run, scenario_files
from koop_lab.hil.scenario import read

ALWAYS = ("rig-other", "kill-lifter")
NAMES = [path.stem for path in scenario_files()]
CHOSEN = NAMES if os.environ.get("KOOP_HIL") == "all" else [n for n in NAMES if n in ALWAYS]


@pytest.mark.slow
@pytest.mark.parametrize("name", CHOSEN)
def test_the_scenario_passes(name, tmp_path):
    verdict = run(read(find(name)), tmp_path)
    assert verdict.passed, verdict.failures
    assert (tmp_path / "verdict.json").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_file_is_valid(name):
    assert read(find(name)).setting.description
