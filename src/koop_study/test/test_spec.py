"""Experiment files: what is accepted, and what a wrong one is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from koop_core.config.parameter import ConfigError
from koop_study.experiments.kinds import read, read_folder
from koop_study.simulation.case import Case, override


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("experiment: mods", r"unknown experiment 'mods': did you mean 'modes'\?"),
        ("seeds: {first: 0, count: 2}", "unknown experiment None"),
        ("experiment: modes", "'seeds' is missing"),
        ("experiment: modes\nseed: 3", r"unknown key 'seed': did you mean 'seeds'\?"),
        ("experiment: modes\nseeds: 3", "seeds must be a mapping, not 3"),
        ("experiment: modes\nseeds: {first: 0, count: 0}", "need at least one"),
        ("experiment: modes\nseeds: {first: zero, count: 1}", "expected int, got 'zero'"),
        ("experiment: modes\nseeds: {first: 0, count: 2}\nquick: 5", "quick must be a mapping"),
        ("- a\n- b", "the file must be a mapping"),
        ("a: [", "cannot be read as YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read(path, False)


def test_a_folder_without_experiments_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no experiment files"):
        read_folder(tmp_path, False)


def test_an_unknown_setting_names_the_nearest_one() -> None:
    with pytest.raises(ConfigError, match=r"'esc.dwel': did you mean 'esc.dwell'\?"):
        override(Case(), {"esc.dwel": 1.0})


def test_a_value_out_of_range_names_its_setting() -> None:
    with pytest.raises(ConfigError, match=r"esc\.step_size = 20: must be 0 to 10"):
        override(Case(), {"esc.step_size": 20.0})


def test_an_ablation_is_checked_before_anything_runs(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(
        "experiment: cases\ntitle: A\ntext: B\nseeds: {first: 0, count: 1}\n"
        "costs: {raw: {cost: raw}}\ntables:\n"
        "  - {name: a, title: A, parameters: [esc.dwell], values: [5, -1]}\n"
    )
    with pytest.raises(ConfigError, match=r"tables\[0\].*esc\.dwell = -1"):
        read(path, False)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lifter.measured": "/a:b"}, r"lifter\.measured: a study has no topics"),
        ({"lifter.cost": "raw"}, r"lifter\.cost: the study's own setting 'cost'"),
    ],
)
def test_a_setting_without_effect_is_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        override(Case(), settings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "experiment: cases\ntitle: A\ntext: B\nseeds: {first: 0, count: 1}\n"
            "costs: {raw: {cost: raw}}\nsettings: {plant.seed: 3}\n"
            "tables: [{name: a, title: A}]",
            r"plant\.seed: is drawn from the seeds",
        ),
        (
            "experiment: modes\nseeds: {first: 0, count: 1}\nsettings: {esc.dwell: 3}",
            r"esc\.dwell: has no effect on the modes",
        ),
        (
            "experiment: static_maps\nramps: [10.0]\ncosts: {raw: {cost: raw, esc.dwell: 3}}",
            r"esc\.dwell: has no effect on a static map",
        ),
        ("experiment: static_maps\nramps: []\ncosts: {raw: {cost: raw}}", "ramps = .*at least one"),
        ("experiment: static_maps\nramps: [-1.0]\ncosts: {raw: {cost: raw}}", "of 1 to 1e6 s"),
        (
            "experiment: cases\ntitle: A\ntext: B\ncosts: {raw: {cost: raw}}\n"
            "tables: [{name: a, title: A, costs: [row]}]",
            "table a: unknown cost 'row': did you mean 'raw'",
        ),
        ("experiment: cases\ntitle: A\ntext: B\ncosts: {}\ntables: []", "tables: needs at least"),
        ("experiment: [modes]", r"unknown experiment \['modes'\]"),
        (
            "experiment: cases\ntitle: A\ntext: B\ncosts: {raw: {cost: raw}}\n"
            "tables: [{name: a, title: A, parameters: [esc.dwell], grid: [5.0]}]",
            "must be a list for each parameter",
        ),
        (
            "experiment: cases\ntitle: A\ntext: B\ncosts: {raw: {cost: raw}}\n"
            "settings: {duration: long}\ntables: [{name: a, title: A}]",
            "duration = 'long': must be above 0",
        ),
        (
            "experiment: cases\ntitle: A\ntext: B\ncosts: {raw: {cost: raw, plant.mu: -1}}\n"
            "tables: [{name: a, title: A}]",
            r"plant\.mu = -1: must be",
        ),
        (
            "experiment: knobs\nseeds: &seeds {first: 0, count: 1}\nknobs: [2]\nconditions: [10]\n"
            "duration: 100\nplant_knobs: [2]\ncommissioned: {seeds: *seeds, knobs: [2], "
            "conditions: [10], family: {}, rate: -1.0, excitation: 9, duration: 9, effort: 1}",
            r"commissioned: rate = -1: must be",
        ),
    ],
)
def test_an_experiment_that_cannot_work_is_refused_before_it_runs(
    text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read(path, False)
