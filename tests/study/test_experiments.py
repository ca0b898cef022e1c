"""The repository's experiments: valid, and what their headlines are made of."""

from __future__ import annotations

from pathlib import Path

import pytest

from koop_study.experiments.kinds import KINDS, read, read_folder
from koop_study.over_dds import headline, headlines, record
from koop_study.simulation.case import Case
from vdp_plant.config import PlantConfig

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"


@pytest.mark.parametrize("quick", [False, True])
def test_the_repositorys_experiments_are_valid_and_of_every_kind(quick: bool) -> None:
    assert [e.kind for e in read_folder(EXPERIMENTS, quick)] == list(KINDS)


def test_quick_replaces_settings_and_is_no_setting_itself() -> None:
    full, quick = (read(EXPERIMENTS / "modes.yaml", q) for q in (False, True))
    assert full.config.seeds.count == 32
    assert quick.config.seeds.count < 32
    assert "quick" not in full.content
    assert "quick" not in quick.content


def test_headlines_are_the_rows_of_the_closed_loop_table() -> None:
    config = read(EXPERIMENTS / "closed_loop.yaml", False).config
    found = headlines(config)
    assert [item.name for item in found] == list(config.costs)
    by_name = {item.name: item for item in found}
    assert by_name["raw"].model is None
    assert by_name["raw"].parameters.lifter.cost == "raw"
    assert by_name["contrast"].parameters.lifter.cost == "lifted"
    assert by_name["lifted"].parameters.plant == PlantConfig()
    assert by_name["lifted"].steps == 500_000


def test_a_run_that_was_broken_off_is_not_taken_for_the_run(tmp_path: Path) -> None:
    (tmp_path / "bag").symlink_to(ROOT / "recordings" / "golden" / "run" / "bag")
    short = headline("golden", Case(cost="raw", duration=10.0))
    assert record(short, tmp_path).step.size == short.steps == 2000
    longer = headline("golden", Case(cost="raw", duration=20.0))
    with pytest.raises(ValueError, match="the first 2000 of 4000 steps"):
        record(longer, tmp_path)
