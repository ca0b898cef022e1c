"""The scenario files, run and judged by pytest; `koop hil` runs the same files by hand.

By default one rig and one fault; KOOP_HIL names others, or files, and `all` is every scenario:

    KOOP_HIL=all ./koop test tests/hil/test_scenarios.py --junitxml=hil.xml
"""

import os

import pytest

from koop_hil.run import run
from koop_hil.scenario import find, read, shipped

NAMES = [path.stem for path in shipped()]
CHOSEN = os.environ.get("KOOP_HIL", "rig-other kill-lifter").split()
JUDGED = NAMES if CHOSEN == ["all"] else CHOSEN
FIGURES = ("tail_error", "max_error", "time_out_of_tolerance", "unrecorded")


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("name", JUDGED)
def test_the_scenario_passes(name, tmp_path, record_property):
    verdict = run(read(find(name)), tmp_path)
    if verdict.skipped:
        pytest.skip(verdict.skipped)
    for figure in FIGURES:
        record_property(figure, getattr(verdict, figure))
    assert verdict.passed, verdict.failures
    assert (tmp_path / "verdict.json").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_every_scenario_file_is_valid(name):
    assert read(find(name)).setting.description
