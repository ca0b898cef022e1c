"""r*, the settled cost at the optimum: on costs whose mean is known, and of the loop itself."""

from dataclasses import replace

import numpy as np
import pytest

from koop_loop.loop import simulate
from koop_loop.metrics import evaluate
from koop_loop.parameters import make
from koop_loop.static_map import performance, settled


@pytest.mark.parametrize(("drift", "averaged"), [(0.1, 2.0 * np.pi / 0.1), (0.0, 200.0)])
def test_a_settled_cost_covers_one_period_of_the_drift_without_the_transient(drift, averaged):
    loop = make({"vdp_plant": {"drift_frequency": drift}, "koopman_lifter": {"cost": "raw"}})
    r = settled(loop, None, -3.0)
    assert r.size == round(averaged / 0.005)
    assert r.min() > 0.0  # the detector begins at 0


def test_a_run_that_rests_at_the_optimum_has_hardly_an_error():
    """A controller that never moves, at theta* from the start, makes the static map itself."""
    values = {
        "vdp_plant": {"theta_initial": -3.0},
        "koopman_lifter": {"cost": "raw"},
        "relay_esc": {"theta_initial": -3.0, "step_size": 0.0},
    }
    loop = make(values)
    drift = 2.0 * np.pi / loop.plant.drift_frequency
    run = simulate(loop.plant, loop.lifter, loop.esc, None, round((100.0 + drift) / 0.005))
    metrics = performance(loop, None, run.t, run.theta, run.r)
    r_star = float(run.r[run.t >= 100.0].mean())
    expected = evaluate(run.t, run.theta, run.r, -3.0, r_star)
    assert metrics.e_r_ss == pytest.approx(expected.e_r_ss, rel=1e-12)


def test_limits_of_the_controller_do_not_move_the_map():
    values = {"koopman_lifter": {"cost": "raw"}}
    free = make(values)
    limited = replace(free, esc=replace(free.esc, theta_min=-1.0, rate_limit=0.01))
    t = np.arange(1000) * 0.005
    theta, r = np.zeros(1000), np.linspace(0.0, 1.0, 1000)
    assert performance(limited, None, t, theta, r) == performance(free, None, t, theta, r)


@pytest.mark.parametrize(
    "controller",
    [
        {"law": "adaptive", "widest": (-6.0, 6.0)},
        {"theta_scale": "log", "theta_min": 0.1},
        {"law": "adaptive", "begin": (1.0, 1.0, *13 * [0.0])},
    ],
)
def test_the_map_is_of_the_plant_alone(controller):
    """Failed before: refused, refused, and at the theta from which the controller goes on."""
    free = make({"vdp_plant": {"drift_frequency": 0.0}, "koopman_lifter": {"cost": "raw"}})
    sought = replace(free, esc=replace(free.esc, **controller))
    assert np.array_equal(settled(sought, None, 3.0), settled(free, None, 3.0))


def test_the_map_of_an_actuator_that_cannot_reach_the_optimum_ends_at_its_limit():
    values = {"vdp_plant": {"theta_min": -1.0}, "koopman_lifter": {"cost": "raw"}}
    limited = make(values)
    moved = replace(limited, plant=replace(limited.plant, theta_min=-5.0))
    t = np.arange(1000) * 0.005
    theta, r = np.zeros(1000), np.linspace(0.0, 1e-9, 1000)  # nothing beside r*
    at_the_limit, at_the_optimum = (
        performance(loop, None, t, theta, r).e_r_ss for loop in (limited, moved)
    )
    assert at_the_limit > 1.01 * at_the_optimum > 0.0
