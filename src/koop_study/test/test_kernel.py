"""The study's kernel is the nodes' loop, and its scenarios do what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from koop_core.stream.monitor import StreamMonitor
from koop_lab.commands.simulate import run as simulated
from koop_loop.loop import LoopDiverged, simulate
from koop_loop.parameters import make
from koop_loop.training import train
from koop_study.simulation import maps
from koop_study.simulation.case import Case, ScenarioConfig, override, seeded
from koop_study.simulation.learning import interference, model_of
from koop_study.simulation.run import expose, measure, run
from koop_study.simulation.work import runs
from koopman_lifter import cost
from relay_esc import relay
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig

SHORT = {"duration": 150.0, "training.trajectories": 10, "training.duration": 10.0}


@pytest.mark.parametrize("cost", ["raw", "lifted"])
def test_without_scenario_it_is_the_nodes_loop_to_the_last_bit(cost: str) -> None:
    case = seeded(override(Case(), {**SHORT, "cost": cost}), 7)
    model = train(PlantConfig(), case.training)
    expected = simulate(case.plant, replace(case.lifter, cost=cost), case.esc, model, case.steps)
    trace = run(case)
    assert trace.theta.tobytes() == expected.theta.tobytes()
    assert trace.r.tobytes() == expected.r.tobytes()
    assert trace.ground_truth.tobytes() == expected.ground_truth.tobytes()


LIMITS = {  # each of them acts within a minute; y_out_max in 2 % of the states
    "plant.theta_min": 1.7, "plant.theta_max": 2.2, "plant.theta_rate": 0.04,
    "lifter.y_out_max": {"raw": 26.0, "lifted": 1e13},
    "esc.dwell": 1.0, "esc.theta_min": 1.5, "esc.theta_max": 2.1, "esc.rate_limit": 0.06,
}  # fmt: skip


def limited(cost: str, **settings: object) -> Case:
    limits = {name: v[cost] if isinstance(v, dict) else v for name, v in LIMITS.items()}
    return seeded(
        override(Case(), {**SHORT, "duration": 60.0, "cost": cost} | limits | settings), 3
    )


def test_with_delays_it_is_the_nodes_loop_to_the_last_bit() -> None:
    options = {"sensing.delays": 4, "sensing.spacing": 0.1, "training.degree": 1, "duration": 20.0}
    case = override(Case(cost="contrast"), {**options, "training.trajectories": 20})
    trace = run(case)
    loop = simulate(case.plant, case.lifter, case.esc, model_of(case), case.steps)
    np.testing.assert_array_equal(trace.r, loop.r)
    np.testing.assert_array_equal(trace.theta, loop.theta)
    assert np.isnan(trace.r[:60]).all()
    assert np.isfinite(trace.r[60:]).all()
    # one channel of the two is the same loop of one channel
    one = override(case, {"sensing.channels": "x"})
    assert model_of(one).delays.channels == 1
    assert not np.array_equal(run(one).r[60:], trace.r[60:])


@pytest.mark.parametrize("cost", ["raw", "lifted"])
def test_every_limit_acts_as_in_the_nodes_loop_to_the_last_bit(cost: str) -> None:
    case = limited(cost)
    lifter = replace(case.lifter, cost=cost)
    expected = simulate(case.plant, lifter, case.esc, model_of(case), case.steps)
    trace = run(case)
    assert trace.theta.tobytes() == expected.theta.tobytes()
    assert trace.r.tobytes() == expected.r.tobytes()
    assert trace.ground_truth.tobytes() == expected.ground_truth.tobytes()
    assert 10 < np.isnan(trace.r).sum() < case.steps / 2


@pytest.mark.parametrize("name", LIMITS)
def test_no_limit_is_silently_ignored(name: str) -> None:
    """Theta is led through all of them: down at first, up later."""
    default = {path: getattr(getattr(Case(), part), field) for path in LIMITS
               for part, _, field in [path.partition(".")]}  # fmt: skip
    only = limited("raw", **{path: value for path, value in default.items() if path != name})
    only = override(only, {"esc.dwell": 1e4, **({"esc.dwell": 1.0} if name == "esc.dwell" else {})})
    if name.endswith("theta_max"):  # theta begins in the lower half, and goes up
        only = override(only, {"esc.theta_min": 1.99})
    without = override(only, {name: default[name]})
    actual, free = (run(case).ground_truth for case in (only, without))
    assert not np.array_equal(actual, free)


def test_what_follows_on_lost_states_is_told_by_the_timeouts_as_in_the_nodes() -> None:
    case = override(
        Case(),
        {"cost": "raw", "duration": 400.0, "esc.dwell": 1.0, "scenario.lost": 0.99},
    )  # fmt: skip
    trace = run(case)
    lost = expose(case.scenario, case.plant, case.steps, case.plant.seed).lost
    states, costs = StreamMonitor("state", 0.5, 0.005), StreamMonitor("cost", 0.5, 0.005)
    detector, relay_state = cost.initial(), case.esc.initial()
    work = cost.workspace(cost.no_lifting())
    params = case.lifter.detector_params(), case.esc.params(case.plant.dt)
    for k in np.flatnonzero(~lost).tolist():
        x = np.array(dynamics.measure(case.plant.params(), k, *trace.ground_truth[k]))
        arrivals = [int(monitor.hear(k, 0.0, 0.0)) for monitor in (states, costs)]
        r, _, settling, detector = cost.answer(
            cost.RAW, cost.no_lifting(), params[0], detector, arrivals[0], k, x, work
        )
        relay_state, _, _ = relay.answer(
            params[1], relay_state, arrivals[1], False, settling, r, False
        )
        assert (trace.r[k], trace.theta[k]) == (r, relay_state.output)
    assert min(states.silences, costs.silences) > 50


def test_an_actuator_rests_where_a_schedule_begins() -> None:
    settings = {"cost": "raw", "duration": 20.0, "plant.initial_state": [1.0, 0.0]}
    slow = override(Case(), {**settings, "plant.theta_rate": 1e-3})
    schedule = np.full(slow.steps, -1.0)
    at_once = run(override(Case(), settings), schedule=schedule)
    trace = run(slow, schedule=schedule)
    assert np.array_equal(trace.ground_truth, at_once.ground_truth)


def test_a_run_has_the_figures_that_koop_simulate_prints() -> None:
    case = override(Case(), {"cost": "raw", "duration": 150.0})
    ours = measure(case, run(case), maps.optimal_cost(case))
    values = {"koopman_lifter": {"cost": "raw"}, "vdp_plant": {"duration": 150.0}}
    _, theirs = simulated(make(values))
    assert ours["iae"] == theirs.iae_theta
    assert ours["ise"] == theirs.ise_theta
    assert ours["t_theta"] == theirs.t_theta
    assert ours["tail"] == theirs.tail_error
    assert ours["e_r_ss"] == theirs.e_r_ss is not None


def test_the_map_at_the_optimum_is_r_star() -> None:
    case = override(Case(), {"cost": "raw"})
    (at_optimum,) = np.flatnonzero(maps.grid() == case.plant.theta_star)
    assert maps.grid()[at_optimum] == -3.0
    assert maps.settled(case, -3.0).mean() == maps.optimal_cost(case)


def test_an_optimum_that_swings_and_jumps_is_the_plant_fed_with_theta_less_the_displacement() -> (
    None
):
    still = override(Case(), {"duration": 20.0, "cost": "raw", "plant.initial_state": [1.0, 0.0]})
    moving = {"optimum_swing": 1.0, "optimum_period": 20.0, "optimum_jump": 0.5, "jump_every": 5.0}
    case = override(still, {f"scenario.{name}": value for name, value in moving.items()})
    schedule = np.linspace(1.0, -1.0, case.steps)
    t = np.arange(case.steps) * 0.005
    displaced = np.sin(2.0 * np.pi * t / 20.0) + 0.5 * (np.floor(t / 5.0) % 2.0)
    trace = run(case, schedule=schedule)
    fed = run(still, schedule=schedule - displaced)
    assert np.array_equal(trace.theta, schedule)
    assert np.array_equal(trace.ground_truth, fed.ground_truth)
    assert np.array_equal(trace.r, fed.r)
    unmoved = run(still, schedule=schedule)
    assert np.abs(trace.ground_truth - unmoved.ground_truth).max() > 1.0


def test_theta_less_a_displacement_is_the_plant_with_that_optimum() -> None:
    # 30 s: rounding of theta - s - theta* grows too little to matter
    settings = {"duration": 30.0, "cost": "raw", "plant.initial_state": [1.0, 0.0]}
    there = override(Case(), {**settings, "plant.theta_star": -2.0})
    case = override(Case(), settings)
    schedule = np.full(case.steps, 0.5)
    trace = run(case, schedule=schedule - 1.0)
    other = run(there, schedule=schedule)
    assert np.allclose(trace.ground_truth, other.ground_truth, rtol=0.0, atol=1e-6)


def test_metrics_follow_a_moving_optimum() -> None:
    case = override(
        Case(),
        {"duration": 400.0, "cost": "raw", "scenario.optimum_swing": 1.5, "esc.step_size": 0.0},
    )
    t = np.arange(case.steps) * case.plant.dt
    perfect = -3.0 + 1.5 * np.sin(2.0 * np.pi * t / 1000.0)
    trace = run(case, schedule=perfect)
    assert measure(case, trace)["iae"] == pytest.approx(0.0, abs=1e-9)


def test_a_lost_state_leaves_theta_and_cost_as_they_were() -> None:
    case = override(Case(), {"duration": 60.0, "cost": "raw", "scenario.lost": 0.5})
    trace = run(case)
    lost = expose(case.scenario, case.plant, case.steps, case.plant.seed).lost
    assert 0.48 < lost.mean() < 0.52  # 12 000 draws: four standard deviations are 0.018
    held = np.flatnonzero(lost)
    assert np.array_equal(trace.theta[held], trace.theta[held - 1])
    assert np.array_equal(trace.r[held], trace.r[held - 1])
    moved = np.flatnonzero(~lost)[2:]
    assert (trace.theta[moved] != trace.theta[moved - 1]).all()


def test_a_schedule_replaces_the_controller() -> None:
    case = override(Case(), {"duration": 5.0, "cost": "raw"})
    schedule = np.linspace(1.0, -1.0, case.steps)
    assert np.array_equal(run(case, schedule=schedule).theta, schedule)


def test_second_channel_gets_gain_and_lag() -> None:
    plant = PlantConfig()
    config = ScenarioConfig(interference_gain_y=0.5, interference_lag_y=0.1)
    t = np.arange(1000) * plant.dt
    added = expose(config, plant, t.size, 0).added
    assert np.array_equal(added[:, 0], np.zeros(t.size))
    expected = 0.5 * (10.5 * np.sin(3.2 * (t - 0.1)) + 11.1 * np.sin(7.8 * (t - 0.1)))
    assert np.allclose(added[:, 1] + interference(plant, t), expected, rtol=0.0, atol=1e-12)


def test_a_run_that_diverges_counts_as_the_worst() -> None:
    settings = {"duration": 50.0, "cost": "raw", "plant.initial_state": [1e3, 1e3]}
    with pytest.raises(LoopDiverged):
        run(override(Case(), settings))
    (row,) = runs(settings, [0])
    assert row["iae"] == np.inf
    assert row["converged"] == 0.0


def test_seeds_draw_state_model_and_phases_and_nothing_else() -> None:
    one, two = seeded(Case(), 1), seeded(Case(), 2)
    assert one == seeded(Case(), 1)
    assert one.plant.seed != two.plant.seed
    assert one.training.seed != two.training.seed
    assert one.plant.interference_phase_1 != two.plant.interference_phase_1
    assert (one.lifter, one.esc, one.scenario) == (two.lifter, two.esc, two.scenario)
    raw = override(one, {"cost": "raw"})
    assert model_of(raw) is None
