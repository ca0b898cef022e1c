"""The experiment ``commission``: which rigs it draws, and how it counts what was said of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from koop_core.config.objects import parse
from koop_core.config.parameter import ConfigError
from koop_study.commissioning.work import Loops
from koop_study.experiments import commission
from koop_study.experiments.commission import CommissionConfig, section
from koop_study.experiments.seeds import Seeds
from koop_study.family.config import FamilyConfig
from koop_study.family.rig import draw

STRATA = {"usual": {}, "deep": {"depth": [5.0, 100.0], "channels": [1, 4]}}
CONFIG = CommissionConfig(Seeds(10, 3), STRATA, family={"channels": [1, 2]})


def row(stratum: str, **changes: Any) -> dict[str, Any]:
    """Return what is noted of a rig that was damped, and was said to be."""
    usual = {"seed": 1, "stratum": stratum, "shape": "narrow", "has_optimum": True,
             "verdict": "tuned", "damped": True, "excited": 100.0, "ratio": [1.0, 1.2]}  # fmt: skip
    return {name: value for name, value in {**usual, **changes}.items() if value is not None}


def test_each_stratum_has_its_family_and_fresh_seeds() -> None:
    drawn = [unit.arguments for unit in commission.units(CONFIG)]
    assert [(one["stratum"], one["seed"]) for one in drawn] == [
        ("usual", 10), ("usual", 11), ("usual", 12), ("deep", 13), ("deep", 14), ("deep", 15),
    ]  # fmt: skip
    assert drawn[0]["family"] == {"channels": [1, 2]}
    assert drawn[-1]["family"] == {"depth": [5.0, 100.0], "channels": [1, 2]}


def test_a_wrong_stratum_is_refused_by_its_name() -> None:
    settings = {"rigs": {"first": 0, "count": 1}, "strata": {"odd": {"deep": 1}}}
    with pytest.raises(ConfigError, match="strata: odd: unknown key 'deep'"):
        parse(CommissionConfig, settings, "file")
    with pytest.raises(ConfigError, match="needs at least one"):
        parse(CommissionConfig, {**settings, "strata": {}}, "file")


def test_words_and_truths_are_counted() -> None:
    far = [1.0, 1.6]
    advised = {"verdict": "monotone", "damped": False, "ratio": None}
    rows = [
        row("usual", seed=1),
        row("usual", seed=2, damped=False),  # falsely not
        row("usual", seed=3, ratio=far),  # falsely damped
        row("usual", seed=4, ratio=far, damped=False),
        row("usual", seed=5, verdict="flat", damped=False, ratio=None, excited=400.0),
        row("usual", seed=6, **advised, advised=1.1),
        row("deep", seed=7, has_optimum=False, **advised, advised=1.0),
        row("deep", seed=8, has_optimum=False, **advised, advised=3.0),  # the wrong limit
        row("deep", seed=9, has_optimum=False, shape="flat"),  # theta changes nothing
        row("deep", seed=10, has_optimum=False, shape="monotone"),
        row("deep", seed=11, has_optimum=False, verdict="error", damped=False, ratio=None),
    ]
    summary, mistakes = section(CONFIG, rows).tables
    counted = {
        name: [summary.cell(name, column.key) for column in summary.columns[1:]]
        for name in ("usual", "deep", "all")
    }
    assert counted["usual"] == ["6", "6", "1", "33.3", "–", "2", "1", "1", "100"]
    assert counted["deep"] == ["5", "0", "0", "–", "20.0", "2", "1", "0", "100"]
    assert counted["all"] == ["11", "6", "1", "33.3", "20.0", "4", "2", "1", "100"]
    assert [texts[0] for texts in mistakes.texts()] == ["2", "3", "4", "5", "8", "9", "11"]


def test_an_optimum_moves_on_from_loop_to_loop() -> None:
    rig = draw(FamilyConfig(drift=(0.1, 0.1)), 7)
    speed, dt = rig.params.drift, rig.params.dt
    places = [each.params.best for each in Loops(rig, 7, 400).later(1, 2.0, 1000).rigs]
    way = np.diff([rig.params.best, *places])
    assert way == pytest.approx([1000 * speed * dt, 800 * speed * dt])


def test_no_round_of_a_verification_repeats_the_noise_of_another() -> None:
    first = Loops(draw(FamilyConfig(), 7), 7, 400)
    rounds = [first, first.later(1, 1.0, 800), first.later(2, 2.0, 1600)]
    drawn = [noise.numbers for loops in rounds for noise in loops.noises]
    assert [len(numbers) for numbers in drawn] == [400, 400, 400, 400, 800, 800]
    alike = np.corrcoef([numbers[:400, 0] for numbers in drawn]) - np.eye(6)
    assert np.abs(alike).max() < 0.25  # five standard errors of 400 numbers


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_resting_theta_is_judged_by_the_amplitude_there(sense: float) -> None:
    rig = draw(FamilyConfig(drift=(0.0, 0.0), depth=(8.0, 8.0), maps={"symmetric": 1.0}), 7)
    rig = replace(rig, params=rig.params._replace(sense=sense))
    p, (theta, best) = rig.params, rig.best()
    worse = (rig.amplitude(p.theta_min) / best) ** sense
    assert worse > 2.0
    assert rig.excess(theta, 100.0) == pytest.approx(1.0)
    assert rig.excess(p.theta_min, 100.0) == pytest.approx(worse)
