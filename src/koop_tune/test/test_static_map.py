"""Static maps: errors against the spread of many maps, curves and cliffs against known ones."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from koop_tune.excitation.static_map import GRID, MapSettings, StaticMap

U = np.linspace(0.0, 1.0, 9)


def drawn(truth, rng, between, within, visits=4):
    """Return a map of visits that differ, each with an error."""
    return StaticMap.from_visits(
        U,
        [(i, y + rng.normal(0.0, between) + rng.normal(0.0, within), within)
         for i, y in enumerate(truth) for _ in range(visits)],
        1.0,
    )  # fmt: skip


@pytest.mark.parametrize(("between", "within"), [(0.2, 0.01), (0.05, 0.2)])
def test_errors_are_the_spread_of_the_means_of_many_maps(between, within):
    rng = np.random.default_rng(0)
    maps = [drawn(0.0 * U, rng, between, within) for _ in range(400)]
    spread = np.std([m.mean for m in maps])
    errors = np.mean([m.error for m in maps])
    # visits differ by their errors, too, and the larger of both counts: never too small
    assert spread == pytest.approx(math.hypot(between, within) / 2.0, rel=0.05)
    assert spread < 1.1 * errors < 1.6 * spread


def test_a_value_where_visits_differ_more_says_so_but_not_of_all_others():
    visits = [(i, 0.01 * k, 0.01) for i in range(9) for k in (-1, 1)]
    visits += [(4, 2.0, 0.01), (4, -2.0, 0.01)]  # to and fro between two amplitudes
    errors = StaticMap.from_visits(U, visits, 1.0).error
    assert errors[4] > 0.5
    assert np.delete(errors, 4).max() < 0.05


def test_the_map_of_one_visit_each_has_the_errors_of_the_visits():
    found = StaticMap.from_visits(U, [(i, float(u), 0.1) for i, u in enumerate(U)], 1.0)
    assert found.mean.tolist() == U.tolist()
    assert found.error == pytest.approx(np.full(9, 0.1))
    sharp = StaticMap.from_visits(U, [(i, float(u), 0.0) for i, u in enumerate(U)], 1.0)
    assert sharp.error == pytest.approx(np.full(9, MapSettings().least_error))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_curve_of_a_sharp_map_is_the_map(sense):
    truth = CubicSpline(U, 2.0 * (U - 0.42) ** 2)
    y = sense * truth(U)
    found = StaticMap(U, y, np.full(9, 1e-3), sense, [np.full(2, v) for v in y])
    grid = np.linspace(0.0, 1.0, GRID)
    assert found.curve(found.mean) == pytest.approx(sense * truth(grid), abs=0.02)
    assert found.best() == pytest.approx(0.42, abs=0.0625)  # nine points, a curve without overshoot
    assert found.interior
    assert not found.flat


def test_the_curve_of_a_noisy_map_has_one_optimum_and_is_nearer_than_its_points():
    rng, truth = np.random.default_rng(1), 3.0 * (U - 0.5) ** 2
    grid = np.linspace(0.0, 1.0, GRID)
    off_curve, off_points = [], []
    for _ in range(100):
        found = drawn(truth, rng, 0.1, 0.1)
        curve = found.curve(found.mean)
        turns = np.diff(np.sign(np.diff(curve)[np.abs(np.diff(curve)) > 1e-12]))
        assert np.count_nonzero(turns) <= 1
        off_curve.append(curve - 3.0 * (grid - 0.5) ** 2)
        off_points.append(found.mean - truth)
    assert np.std(off_curve) < np.std(off_points)


def test_two_optima_beyond_doubt_are_kept():
    y = np.cos(4.0 * np.pi * U)
    found = StaticMap(U, y, np.full(9, 0.01), 1.0, [np.full(2, v) for v in y])
    curve = found.curve(found.mean)
    assert curve[GRID // 4] < -0.9
    assert curve[GRID // 2] > 0.9
    assert curve[3 * GRID // 4] < -0.9


def test_maps_of_other_weights_scatter_as_the_errors_say():
    rng = np.random.default_rng(2)
    found = drawn(U, rng, 0.2, 0.01, visits=12)
    others = [found.reweigh(found.draw_weights(rng)) for _ in range(2000)]
    # the Bayesian bootstrap's deviation is that of the mean over sqrt(1 + 1/n)
    assert np.mean(others, axis=0) == pytest.approx(found.mean, abs=0.02)
    assert np.std(others, axis=0) == pytest.approx(found.error * math.sqrt(12 / 13), rel=0.1)
    alike = StaticMap(U, U, np.full(9, 0.1), 1.0, [np.full(3, v) for v in U])
    assert alike.reweigh(alike.draw_weights(rng)) == pytest.approx(U)


def cliff_map(edge, height, side=1, sense=1.0):
    y = np.where(edge > U, -0.05 * U, height)
    y = sense * (y if side > 0 else y[::-1])
    return StaticMap(U, y, np.full(9, 0.05), sense, [np.full(2, v) for v in y])


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("side", [1, -1])
def test_a_cliff_is_between_the_last_good_value_and_the_first_beyond(side, sense):
    found = cliff_map(0.6, math.log(10.0), side, sense)
    cliff = found.cliff(side)
    assert (cliff.inner, cliff.outer) == ((4, 5) if side > 0 else (4, 3))
    assert cliff.height == pytest.approx(math.log(10.0) + 0.025, abs=1e-9)
    assert found.cliff(-side) is None
    assert cliff_map(0.6, math.log(6.0), side, sense).cliff(side) is None  # a steep side
    assert cliff_map(2.0, 5.0, side, sense).cliff(side) is None


def test_a_value_with_one_bad_visit_is_beyond_the_cliff():
    y = np.where(U < 0.6, 0.1 * np.abs(U - 0.25), math.log(10.0))
    visits = [np.full(2, v) for v in y]
    visits[4] = np.array([y[4], math.log(10.0)])  # good when it was come to from below
    cliff = StaticMap(U, y, np.full(9, 0.05), 1.0, visits).cliff(1)
    assert (cliff.inner, cliff.outer) == (3, 4)


def test_what_counts_as_a_cliff_is_a_setting():
    y = cliff_map(0.6, math.log(6.0))
    steep = StaticMap(U, y.mean, y.error, 1.0, y.visits, MapSettings(cliff=4.0))
    assert steep.cliff(1) is not None
