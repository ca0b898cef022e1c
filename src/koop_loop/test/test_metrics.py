"""The metrics against a path whose integrals are known."""

import numpy as np
import pytest

from koop_loop.metrics import evaluate

DT = 0.005


def test_an_exponential_approach_has_its_analytic_integrals():
    """error = 5 exp(-t / 50) from t = 100 on: IAE = 250, ISE = 625, < 0.1 after 50 ln 50 s."""
    t = np.arange(500_000) * DT
    error = np.where(t < 100.0, 7.0, 5.0 * np.exp(-(t - 100.0) / 50.0))
    r = np.where(t < 100.0, 1e9, 2.0 + error)
    metrics = evaluate(t, -3.0 + error, r, -3.0, r_star=2.0)
    # rectangle rule: dt / 2 times the first value
    assert metrics.iae_theta == pytest.approx(250.0, abs=0.02)
    assert metrics.ise_theta == pytest.approx(625.0, abs=0.1)
    assert metrics.t_theta == pytest.approx(100.0 + 50.0 * np.log(50.0), abs=2 * DT)
    assert metrics.e_r_ss == pytest.approx(0.0, abs=1e-6)
    assert metrics.converged


def test_a_controller_that_never_arrives():
    t = np.arange(50_000) * DT
    metrics = evaluate(t, np.full(t.size, 2.0), np.linspace(0.0, 1.0, t.size), -3.0, r_star=0.0)
    assert metrics.t_theta is None
    assert not metrics.converged
    assert metrics.tail_error == 5.0
    # r runs from 0.4 to 1 after the start, its tail from 0.82 to 1
    assert metrics.e_r_ss == pytest.approx(0.91 / 0.6, rel=1e-3)


def test_a_run_shorter_than_the_transient_counts_whole():
    t = np.arange(1000) * DT
    metrics = evaluate(t, np.zeros(1000), np.ones(1000), -3.0, r_star=1.0)
    assert metrics.iae_theta == pytest.approx(15.0)
    assert metrics.e_r_ss is None  # r has no range


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="same length"):
        evaluate(np.arange(5.0), np.zeros(4), np.zeros(5), 0.0)


def test_costs_that_are_not_numbers_are_left_out():
    t = np.arange(50_000) * DT
    r = np.linspace(0.0, 1.0, t.size)
    whole = evaluate(t, np.zeros(t.size), r, -3.0, r_star=0.0)
    r[[25_000, 25_001, 45_000]] = np.nan, np.nan, np.inf  # failed before: infinite
    holes = evaluate(t, np.zeros(t.size), r, -3.0, r_star=0.0)
    assert holes.e_r_ss == pytest.approx(whole.e_r_ss, abs=1e-4)  # one of 9000 values of the tail


def test_a_run_that_loses_its_cost_has_no_settled_one():
    """Failed before: NaN, for which JSON has no word."""
    t = np.arange(50_000) * DT
    r = np.linspace(0.0, 1.0, t.size)
    r[25_000:] = np.nan
    assert evaluate(t, np.zeros(t.size), r, -3.0, r_star=0.0).e_r_ss is None
