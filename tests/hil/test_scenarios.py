"""The scenario files, run and judged by pytest; `koop hil` runs the same files by hand.

By default one rig and one fault; with KOOP_HIL=all every scenario.
"""

import os

import pytest

from koop_hil.command import find, run, scenario_files
from koop_hil.scenario import read

NAMES = [path.stem for path in scenario_files()]
JUDGED = NAMES if os.environ.get("KOOP_HIL") == "all" else ["rig-other", "kill-lifter"]


@pytest.mark.slow
@pytest.mark.parametrize("name", JUDGED)
def test_the_scenario_passes(name, tmp_path):
    verdict = run(read(find(name)), tmp_path)
    if verdict.skipped:
        pytest.skip(verdict.skipped)
    assert verdict.passed, verdict.failures
    assert (tmp_path / "verdict.json").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_file_is_valid(name):
    assert read(find(name)).setting.description
