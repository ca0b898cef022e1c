"""Every law against its own theory on quadratic maps; the loop that they all run in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from koop_core.config.parameter import ConfigError
from koop_loop.loop import simulate
from koop_study.experiments.kinds import read
from koop_study.laws import bounded, golden, least_squares, loop, newton, outside, run, stochastic
from koop_study.laws.catalogue import LAWS, trials
from koop_study.laws.plants import PlantConfig, setting
from koop_study.simulation.case import seeded

OPTIMUM = 0.4
PAPER = PlantConfig("paper", False, "raw", 60.0)
RIGS = PlantConfig("rigs", True, "raw", 20.0, settings={"amplitude_time": [2, 4], "clean": 1.0})
CONSTANTS = {"omega_h": 20.0, "omega_l": 4.5}
RELAY = {**CONSTANTS, "speed": 0.1, "dwell": 1.0, "tau_f": 2.0 / 3.0}


def quadratic(curvature: float) -> Callable[[float], float]:
    return lambda u: 3.0 + 0.5 * curvature * (u - OPTIMUM) ** 2


def path(
    kind: int, p: list[float], begin: float, seconds: float, cost: Callable[[float], float],
    dt: float = 0.01,
) -> np.ndarray:  # fmt: skip
    """Return u of a law on a static map, one row a step."""
    m, u = loop.memory(begin), begin
    found = np.empty(round(seconds / dt))
    for k in range(found.size):
        u = loop.answer(kind, np.array([*p, 0.0]), m, dt, u, cost(u))
        found[k] = u
    return found


def rate(u: np.ndarray, period: float, dt: float = 0.01) -> float:
    """Return the exponential rate at which the mean over a period approaches the optimum [1/s]."""
    window = round(period / dt)
    means = u[: u.size // window * window].reshape(-1, window).mean(axis=1) - OPTIMUM
    return -math.log(means[-1] / means[1]) / (period * (means.size - 2))


PERIOD = 2.0 * math.pi  # of a dither of 1 rad/s


@pytest.mark.parametrize("curvature", [1.0, 3.0])
def test_perturbation_converges_at_the_rate_of_its_average(curvature: float) -> None:
    # Krstic and Wang 2000: centre' = -gain a / 2 dJ/du, behind washout and low-pass; these are
    # fast against 0.003 /s, and their gain at the dither is known
    a, omega_w, gain = 0.05, 0.05, 0.12 / curvature
    u = path(
        loop.PERTURBATION, [a, 1.0, gain, omega_w, 0.3], 0.6, 60 * PERIOD, quadratic(curvature)
    )
    washout = 1.0 / (1.0 + omega_w**2)  # in phase with the dither
    assert rate(u, PERIOD) == pytest.approx(gain * a / 2.0 * curvature * washout, rel=0.05)


@pytest.mark.parametrize(("gain", "tolerance"), [(0.16, 0.025), (0.04, 0.01)])
def test_perturbation_follows_the_solution_of_the_averaged_system(
    gain: float, tolerance: float
) -> None:
    # Krstic and Wang 2000, section 3: on a quadratic map the average of the loop is linear,
    #   centre' = -gain g,   g' = omega_g (a / 2 W f'' (centre - u*) - g),
    # W the washout's gain at the dither in phase with it; the loop stays close to it, the closer
    # the slower the centre moves against the dither
    a, omega_w, omega_g, curvature = 0.05, 0.02, 0.1, 2.0
    seconds = 12.0 / gain * PERIOD
    u = path(
        loop.PERTURBATION, [a, 1.0, gain, omega_w, omega_g], 0.6, seconds, quadratic(curvature)
    )
    t = 0.01 * (1.0 + np.arange(u.size))
    centre = u - a * np.sin(t)
    in_phase = 1.0 / (1.0 + omega_w**2)
    average = np.array([[0.0, -gain], [omega_g * 0.5 * a * in_phase * curvature, -omega_g]])
    begin = np.array([0.6 - OPTIMUM, 0.0])
    every = slice(0, u.size, u.size // 60)
    expected = np.array([(expm(average * s) @ begin)[0] for s in t[every]])
    assert np.abs(expected[-1]) < 0.1 * begin[0]
    np.testing.assert_allclose(centre[every] - OPTIMUM, expected, rtol=0.0, atol=tolerance * 0.2)


def test_newton_converges_at_its_gain_whatever_the_curvature() -> None:
    # the message of Ghaffari et al. 2012, figures 3 and 4: the map does not decide the rate
    for curvature in (0.5, 5.0):
        p = [0.05, 1.0, 0.004, 0.05, 0.05, 0.05]
        u = path(loop.NEWTON, p, 0.6, 160 * PERIOD, quadratic(curvature))
        # from when the Riccati filter has found 1 / H
        assert rate(u[u.size // 2 :], PERIOD) == pytest.approx(0.004, rel=0.15)


@pytest.mark.parametrize("curvature", [1.0, 4.0])
def test_least_squares_converges_at_gain_times_curvature(curvature: float) -> None:
    gain = 0.004 / curvature
    u = path(loop.LEAST_SQUARES, [0.05, 1.0, gain, 0.5], 0.6, 60 * PERIOD, quadratic(curvature))
    assert rate(u, PERIOD) == pytest.approx(0.004, rel=0.1)


def test_least_squares_knows_the_slope_of_a_line_exactly() -> None:
    gain = 0.005
    u = path(loop.LEAST_SQUARES, [0.05, 1.0, gain, 0.5], 0.9, 10 * PERIOD, lambda u: 7.0 + 2.0 * u)
    centre = u - 0.05 * np.sin(0.01 * (np.arange(u.size) + 2.0))
    assert centre[-1] - centre[u.size // 2] == pytest.approx(-gain * 2.0 * 5 * PERIOD, rel=1e-3)


def test_bounded_keeps_its_rate_whatever_the_cost_and_descends_on_average() -> None:
    alpha, omega, k = 0.02, 20.0, 2.0
    wild = np.random.default_rng(0)
    u = path(loop.BOUNDED, [alpha, omega, k], 0.5, 20.0, lambda u: wild.normal(0.0, 1e6), 0.005)
    assert np.abs(np.diff(u)).max() <= 0.005 * math.sqrt(alpha * omega) * (1.0 + 1e-9)
    # Scheinker and Krstic 2014: u' = -(k alpha / 2) dJ/du as omega grows
    u = path(loop.BOUNDED, [alpha, 40.0, k], 0.7, 40.0, quadratic(4.0), 0.001)
    assert rate(u, 2.0 * math.pi / 40.0 * 20, 0.001) == pytest.approx(
        k * alpha / 2.0 * 4.0, rel=0.1
    )
    # at the optimum what is left is the dither, sqrt(alpha / omega), and no more
    late = path(loop.BOUNDED, [alpha, 40.0, k], OPTIMUM, 40.0, quadratic(4.0), 0.001)
    assert np.abs(late - OPTIMUM).max() <= 2.0 * math.sqrt(alpha / 40.0) * 1.05


def test_sliding_mode_follows_its_reference_and_then_stays_where_the_slope_is_too_small() -> None:
    # Pan et al. 2003: on a surface J falls at rho, for |dJ/du| gain > rho
    speed, rho, beta, curvature = 0.2, 0.02, 0.01, 4.0
    cost = quadratic(curvature)
    u = path(loop.SLIDING, [speed, rho, beta], 0.9, 30.0, cost, 0.001)
    costs = np.array([cost(v) for v in u])
    begin, end = 1000, 15_000
    fall = (costs[begin] - costs[end]) / (0.001 * (end - begin))
    assert fall == pytest.approx(rho, rel=0.1)
    # the slope suffices down to |u - u*| = rho / (gain H) = 0.025; a swing goes beyond by beta
    assert np.abs(u[-5000:] - OPTIMUM).max() < 0.1


def test_the_stochastic_relay_walks_at_its_mean_speed_and_stays_at_the_optimum() -> None:
    p = [0.01, 1.0, 5.0]
    down = path(loop.STOCHASTIC, p, 0.95, 60.0, lambda u: u)
    # 59 steps of mean 0.01, uniform: standard deviation 0.01 / sqrt(3) * sqrt(59) = 0.044
    assert down[0] - down[-1] == pytest.approx(0.59, abs=0.14)
    assert len(np.unique(np.round(np.diff(np.unique(down)), 6))) > 20
    there = path(loop.STOCHASTIC, p, 0.6, 300.0, quadratic(1.0))
    assert np.abs(there[-15_000:] - OPTIMUM).max() < 0.06
    other = path(loop.STOCHASTIC, [0.01, 1.0, 6.0], 0.95, 60.0, lambda u: u)
    assert not np.array_equal(other, down)


def test_golden_section_needs_as_many_points_as_kiefer_says_and_rests() -> None:
    resolution = 0.02
    u = path(loop.GOLDEN, [1.0, resolution], 0.9, 30.0, lambda u: abs(u - OPTIMUM))
    points = 2 + math.ceil(math.log(resolution) / math.log((math.sqrt(5.0) - 1.0) / 2.0)) - 1
    assert np.count_nonzero(np.diff(u)) == points
    assert u[-1] == pytest.approx(OPTIMUM, abs=resolution)
    assert (u[-1000:] == u[-1]).all()


@pytest.mark.parametrize(
    ("module", "kind", "law"),
    [
        (newton, loop.NEWTON, "newton"),
        (least_squares, loop.LEAST_SQUARES, "least_squares"),
        (bounded, loop.BOUNDED, "bounded"),
        (stochastic, loop.STOCHASTIC, "stochastic"),
        (golden, loop.GOLDEN, "golden"),
    ],
)
def test_compiled_and_plain_step_agree(module, kind: int, law: str) -> None:  # type: ignore[no-untyped-def]
    p = np.array([*LAWS[law].pack({**trials(law, 2)[1], "seed": 3.0}, 10.0), 0.0])
    compiled, plain = loop.memory(0.5), loop.memory(0.5)
    for cost in np.random.default_rng(2).uniform(1.0, 2.0, 3000):
        one = module.step(p, compiled, 0.05, cost)
        other = module.step.py_func(p, plain, 0.05, cost)
        assert one == pytest.approx(other, rel=1e-9)


def test_trials_are_within_each_laws_ranges_and_as_many_for_all() -> None:
    for name, spec in LAWS.items():
        found = trials(name, 8)
        assert len(found) == (8 if spec.ranges else 1)
        for constants in found:
            for constant, value in constants.items():
                low, high = spec.searched[constant]
                assert low <= value <= high


def test_the_relay_in_units_of_u_is_the_relay() -> None:
    case = replace(seeded(PAPER.case(), 3), duration=60.0)
    case = replace(case, esc=replace(case.esc, dwell=3.0, tau_f=2.0))
    expected = simulate(case.plant, replace(case.lifter, cost="raw"), case.esc, None, case.steps)
    constants = {"omega_h": 20.0 / case.plant.mu, "omega_l": 0.3 * 15.0, "speed": 0.1,
                 "dwell": 0.2, "tau_f": 2.0 / 15.0}  # fmt: skip
    found = run.run(setting(PAPER, 3), "relay", constants)
    # theta is 10 u - 5: rounding of 1e-16, which the plant amplifies over a minute
    assert np.allclose(found.theta, expected.theta, rtol=0.0, atol=1e-6)
    assert np.abs(np.diff(np.sign(np.diff(found.theta)))).max() == 2.0  # it has turned


@pytest.mark.parametrize("plant", [PAPER, RIGS])
@pytest.mark.parametrize("law", ["relay", "least_squares"])
def test_a_loop_that_is_left_and_gone_on_with_is_the_same_to_the_last_bit(
    plant: PlantConfig, law: str
) -> None:
    drawn = setting(plant, 1)
    constants = {**CONSTANTS, **trials(law, 1)[0]}
    whole = run.run(drawn, law, constants)
    first, relay_state = drawn.law(law, constants)
    sensing, state, memory = (
        drawn.sensing(constants),
        drawn.initial(relay_state),
        loop.memory(drawn.u),
    )
    r, theta, amplitude = (np.empty(drawn.steps) for _ in range(3))
    for begin in range(0, drawn.steps, 97):
        state = loop.drive(
            drawn.is_rig, drawn.plant, drawn.exposure, drawn.rig, drawn.noise, sensing, first,
            memory, state, begin, min(begin + 97, drawn.steps), r, theta, amplitude,
        )  # fmt: skip
    assert theta.tobytes() == whole.theta.tobytes()
    assert r.tobytes() == whole.r.tobytes()
    assert amplitude.tobytes() == whole.amplitude.tobytes()


def test_the_oracle_scores_one_and_a_knob_left_alone_what_the_map_says() -> None:
    still = replace(RIGS, settings={**RIGS.settings, "drift": [0, 0], "noise_driven": 0.0})
    for seed in range(6):
        drawn = setting(still, seed)
        oracle = run.run(drawn, "oracle", {})
        row = run.measure(drawn, oracle, oracle)
        assert (row["score"], row["failed"], row["swing"]) == (1.0, 0.0, 0.0)
        assert row["converged"] < 1.0
        left = run.run(drawn, "bounded", {**CONSTANTS, "amplitude": 1e-9, "period": 1.0, "gain": 0})
        assert drawn.truth is not None
        ratio = drawn.truth.amplitude(drawn.truth.theta_initial) / drawn.truth.best()[1]
        expected = ratio if drawn.sense > 0.0 else 1.0 / ratio
        # a limit cycle rests at its level
        assert run.measure(drawn, left, oracle)["score"] == pytest.approx(expected, rel=1e-3)


def test_what_the_paper_calls_converged_reached_and_reacquired_is_measured_so() -> None:
    jumping = replace(PAPER, duration=400.0, settings={"scenario.optimum_jump": 2.0,
                                                       "scenario.jump_every": 100.0})  # fmt: skip
    drawn = setting(jumping, 0)
    t = drawn.t()
    # 2 from theta* at first, there from 40 s on; 30 s late after each jump
    theta = np.where(t < 40.0, -1.0, -3.0 + drawn.exposure.displaced)
    for jump in (100.0, 200.0, 300.0):
        late = (t >= jump) & (t < jump + 30.0)
        theta[late] = -3.0 + drawn.exposure.displaced[round((jump - 1.0) / drawn.dt)]
    row = run.measure(drawn, run.Path(np.ones(t.size), theta, np.ones(t.size)), None)
    # the mean over 2 % of the run, 8 s, of a 2 that became 0 is within 0.6 after 5.6 s
    assert row["converged"] == pytest.approx(45.6, abs=0.02)
    assert row["reacquired"] == pytest.approx([30.0, 30.0], abs=0.01)  # the last one is cut short
    assert row["score"] == pytest.approx(3 * 30.0 * 2.0, rel=0.01)  # from 100 s on
    assert row["failed"] == 0.0
    assert row["swing"] == pytest.approx(0.2)


def test_an_optimum_that_swings_does_not_jump() -> None:
    swinging = replace(PAPER, duration=120.0, settings={"scenario.optimum_swing": 1.0})
    drawn = setting(swinging, 0)
    theta = -3.0 + drawn.exposure.displaced
    row = run.measure(drawn, run.Path(np.ones(theta.size), theta, np.ones(theta.size)), None)
    assert row["score"] == pytest.approx(0.0, abs=1e-9)
    assert row["reacquired"] == []


def test_a_law_that_is_asked_rests_between_and_is_told_the_settled_cost() -> None:
    drawn = setting(RIGS, 2)
    told: list[float] = []

    def asking() -> outside.Asking:
        for u in (0.2, 0.9, 0.4):
            told.append((yield u))
        while True:
            yield 0.5

    sensing = drawn.sensing(CONSTANTS)
    law, relay_state = drawn.law("oracle", CONSTANTS)
    r, theta, amplitude = (np.empty(drawn.steps) for _ in range(3))

    def go(state: loop.LoopState, first: int, last: int) -> loop.LoopState:
        return loop.drive(
            drawn.is_rig, drawn.plant, drawn.exposure, drawn.rig, drawn.noise, sensing, law,
            loop.memory(0.0), state, first, last, r, theta, amplitude,
        )  # fmt: skip

    hold = 4.0 * drawn.time
    begin = sensing.detector.settling
    outside.ask_and_tell(asking(), hold, drawn, begin, go, drawn.initial(relay_state), r)
    turns = np.flatnonzero(np.diff(theta)) + 1
    steps = round(hold / drawn.dt)
    assert turns.tolist() == [begin + i * steps for i in range(4)]
    assert [drawn.theta_at(u) for u in (0.2, 0.9, 0.4, 0.5)] == theta[turns].tolist()
    second = r[turns[1] + steps // 2 : turns[2]]
    assert told[1] == pytest.approx(drawn.sense * np.log(second).mean())


BASE = """
experiment: laws
laws: [relay, oracle]
trials: 2
tuning: {first: 0, count: 1}
fresh: {first: 10, count: 1}
drawn: {plant: a, scenario: calm, laws: [relay], seed: 1}
plants:
  - {plant: {name: a, family: true, cost: raw, duration: 5}, within: 3, scenarios: {calm: {}}}
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[relay, oracle]", "[relais]", "unknown law 'relais': did you mean 'relay'"),
        ("first: 10", "first: 0", "tuning and fresh seeds overlap"),
        ("cost: raw", "cost: lifted", "on the family raw or contrast"),
        ("calm: {}}", "calm: {depht: [2, 3]}}", "did you mean 'depth'"),
        ("family: true", "family: false", None),
        ("calm: {}}", "windy: {}}", "the plant has no scenario 'calm'"),
        ("within: 3,", "within: 3, brief: [storm],", "brief: unknown scenario 'storm'"),
        ("trials: 2", "trials: 0", "trials = 0: must be 1 to 4096"),
        ("drawn:", "fixed: [{name: x, law: golden, constants: {hold: 2}}]\ndrawn:",
         "'x' lacks omega_h, omega_l, resolution"),
    ],
)  # fmt: skip
def test_a_wrong_experiment_is_refused_with_the_reason(
    tmp_path: Path, old: str, new: str, message: str | None
) -> None:
    file = tmp_path / "laws.yaml"
    file.write_text(BASE.replace(old, new))
    if message is None:
        assert read(file, False).config.plants[0].plant.cost == "raw"
    else:
        with pytest.raises(ConfigError, match=message):
            read(file, False)


def test_a_python_without_the_rivals_is_told_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        outside.check(str(tmp_path / "python"), ["cern"])
    empty = tmp_path / "python"
    empty.write_text("#!/bin/sh\nexit 1\n")
    empty.chmod(0o755)
    with pytest.raises(ConfigError, match=r"pip install -r requirements/rivals\.txt"):
        outside.check(str(empty), ["cern"])
