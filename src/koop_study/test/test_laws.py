"""Relay and adaptive law on the paper's plant and on random rigs: what is run and measured."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_loop.loop import simulate
from koop_study.experiments.kinds import read
from koop_study.family.loop import close, noise_of
from koop_study.family.rig import draw
from koop_study.family.scaled import ScaledConstants, scaled_to
from koop_study.laws.run import LawPlant, law_runs, paper_row
from koop_study.simulation.case import Case, case_of
from koop_study.simulation.run import Trace, displacement

PAPER_CONSTANTS = ScaledConstants(20.0, 4.5, speed=0.1, dwell=1.0, tau_f=10.0 / 15.0)

PAPER = LawPlant("paper", False, "raw", 60.0)
RIGS = LawPlant(
    "rigs", True, "raw", 20.0,
    {"amplitude_time": [2, 4], "clean": 1.0, "drift": [0, 0], "noise_driven": 0.0},
)  # fmt: skip
IDLE = ScaledConstants(omega_h=20.0, omega_l=4.5, speed=0.0, dwell=1.0, tau_f=1.0)


def test_the_papers_constants_in_units_of_its_plant_are_the_nodes_defaults() -> None:
    plain = case_of(PAPER.paper_settings(), 3)
    scaled = case_of(PAPER.paper_settings(PAPER_CONSTANTS), 3)
    runs = [
        simulate(case.plant, replace(case.lifter, cost="raw"), case.esc, None, case.steps)
        for case in (plain, scaled)
    ]
    # the units come back with a rounding of 1e-16, which the plant amplifies over a minute
    assert np.allclose(runs[0].theta, runs[1].theta, rtol=0.0, atol=1e-6)
    assert np.abs(np.diff(np.sign(np.diff(runs[0].theta)))).max() == 2.0  # it has turned


def test_a_knob_left_alone_scores_what_the_map_says() -> None:
    for seed in range(6):
        rig = draw(RIGS.rigs(), seed)
        ratio = rig.amplitude(rig.theta_initial) / rig.best()[1]
        expected = ratio if rig.params.sense > 0.0 else 1.0 / ratio
        (row,) = law_runs(asdict(RIGS), asdict(IDLE), [seed])
        # a limit cycle rests at its level
        assert row["score"] == pytest.approx(expected, rel=1e-3)
        assert row["failed"] == float(expected > 1.5)


def test_a_knob_left_at_the_best_theta_scores_one_and_is_within_bounds_at_once() -> None:
    rig = draw(RIGS.rigs(), 2)
    resting = replace(rig, theta_initial=rig.best()[0])
    steps = round(RIGS.duration * rig.time / rig.params.dt)
    noise = noise_of(resting, steps, 2)
    actual = close(resting, scaled_to(resting, IDLE, None), noise, 2)
    assert actual.ratio == pytest.approx(1.0, abs=1e-12)
    assert actual.converged <= 0.01


def test_the_adaptive_law_follows_a_rigs_optimum_that_jumps() -> None:
    jumping = replace(
        RIGS, duration=80.0, settings={**RIGS.settings, "jump": [0.3, 0.3], "jump_every": [25, 25],
                                       "quiet": 1.0, "log_scaled": 0.0},
    )  # fmt: skip
    constants = ScaledConstants(
        omega_h=1.0, omega_l=1.0, speed=0.07, dwell=2.0, tau_f=0.8, law="adaptive"
    )
    rows = law_runs(asdict(jumping), asdict(constants), [0, 1, 2, 3])
    assert np.median([row["score"] for row in rows]) < 1.5


def jumping_case() -> tuple[Case, np.ndarray, np.ndarray]:
    settings = {"scenario.optimum_jump": 2.0, "scenario.jump_every": 100.0}
    case = case_of(replace(PAPER, duration=400.0, settings=settings).paper_settings(), 0)
    t = np.arange(case.steps) * case.plant.dt
    return case, t, displacement(case.scenario, case.steps, case.plant.dt)


def test_what_the_paper_calls_converged_reached_and_reacquired_is_measured_so() -> None:
    case, t, displaced = jumping_case()
    # 2 from theta* at first, there from 40 s on; 30 s late after each jump
    theta = np.where(t < 40.0, -1.0, -3.0 + displaced)
    for jump in (100.0, 200.0, 300.0):
        late = (t >= jump) & (t < jump + 30.0)
        theta[late] = -3.0 + displaced[round((jump - 1.0) / case.plant.dt)]
    row = paper_row(case, Trace(t, np.ones(t.size), theta, np.empty((0, 2))))
    assert row["reacquired"] == pytest.approx([30.0, 30.0], abs=0.01)  # the last one is cut short
    assert row["score"] == pytest.approx(3 * 30.0 * 2.0, rel=0.01)  # from 100 s on
    assert row["failed"] == 0.0


def test_an_optimum_that_swings_does_not_jump() -> None:
    swinging = replace(PAPER, duration=120.0, settings={"scenario.optimum_swing": 1.0})
    case = case_of(swinging.paper_settings(), 0)
    displaced = displacement(case.scenario, case.steps, case.plant.dt)
    t, theta = np.arange(case.steps) * case.plant.dt, -3.0 + displaced
    row = paper_row(case, Trace(t, np.ones(t.size), theta, np.empty((0, 2))))
    assert row["score"] == pytest.approx(0.0, abs=1e-9)
    assert row["reacquired"] == []


BASE = """
experiment: laws
seeds: {first: 10, count: 1}
within: 3
laws: [{name: slow, constants: {omega_h: 1, omega_l: 1, speed: 0.1, dwell: 2, tau_f: 1}}]
plants:
  - {plant: {name: a, family: false, cost: raw, duration: 5}, scenarios: {calm: {}}}
  - {plant: {name: b, family: true, cost: raw, duration: 5}, scenarios: {calm: {}}}
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("family: true, cost: raw", "family: true, cost: lifted", "on the family raw or contrast"),
        ("5}, scenarios: {calm: {}}}\n  -", "5}, scenarios: {calm: {"
         "scenario.nois: 1}}}\n  -", "did you mean 'scenario.noise'"),
        ("name: b, family: true, cost: raw, duration: 5", "name: b, family: true, cost: raw, "
         "duration: 5, settings: {depht: [2, 3]}", "did you mean 'depth'"),
        ("name: b", "name: a", "two have the same name"),
        ("speed: 0.1, ", "", "'speed' is missing"),
        ("speed: 0.1", "speed: 0.1, law: golden", "law = 'golden': must be one of relay, adaptive"),
    ],
)  # fmt: skip
def test_a_wrong_experiment_is_refused_with_the_reason(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "laws.yaml"
    file.write_text(BASE)
    assert read(file, False).config.plants[0].plant.cost == "raw"
    assert old in BASE
    file.write_text(BASE.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        read(file, False)
