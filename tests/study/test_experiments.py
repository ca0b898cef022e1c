"""The repository's experiments: valid, and what their headlines are made of."""

from __future__ import annotations

from pathlib import Path

import pytest

from koop_study.experiments.kinds import ORDER, read, read_folder
from koop_study.simulation.case import case_of
from vdp_plant.config import PlantConfig

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"


@pytest.mark.parametrize("quick", [False, True])
def test_the_repositorys_experiments_are_valid_and_of_every_kind(quick: bool) -> None:
    assert [e.path.stem for e in read_folder(EXPERIMENTS, quick)] == [*ORDER, "commission", "knobs"]


def test_quick_replaces_settings_and_is_no_setting_itself() -> None:
    full, quick = (read(EXPERIMENTS / "modes.yaml", q) for q in (False, True))
    assert full.config.seeds.count == 32
    assert quick.config.seeds.count < 32
    assert "quick" not in full.content
    assert "quick" not in quick.content


def test_the_headline_runs_are_the_papers_with_each_cost() -> None:
    experiment = read(EXPERIMENTS / "closed_loop.yaml", False)
    cases = [case_of(unit.arguments["settings"], None) for unit in experiment.units()]
    assert [case.cost for case in cases][:3] == ["raw", "lifted", "contrast"]
    assert {case.plant for case in cases} == {PlantConfig()}
    assert {case.steps for case in cases} == {500_000}
