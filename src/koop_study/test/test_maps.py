"""Shape figures of static maps, on maps whose shape is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from koop_study.simulation import maps
from koop_study.simulation.case import Case, override

THETA_STAR = -3.0


def test_grid_is_the_papers_ramp() -> None:
    grid = maps.grid()
    assert (grid[0], grid[-1]) == (2.0, -5.0)
    assert np.allclose(np.diff(grid), -0.25)


def test_a_parabola_is_convex_monotone_and_has_its_minimum_at_the_optimum() -> None:
    shape = maps.shape(maps.grid(), (maps.grid() - THETA_STAR) ** 2, THETA_STAR)
    assert shape.convexity == 1.0
    assert shape.rank_correlation == pytest.approx(1.0)
    assert shape.argmin == THETA_STAR


def test_a_concave_map_has_no_convex_share() -> None:
    assert maps.shape(maps.grid(), -((maps.grid() - THETA_STAR) ** 2), THETA_STAR).convexity == 0.0


def test_a_misleading_map_has_negative_rank_correlation() -> None:
    r = -np.abs(maps.grid() - THETA_STAR)
    assert maps.shape(maps.grid(), r, THETA_STAR).rank_correlation == pytest.approx(-1.0)


def test_smoothing_is_scipys_moving_average_without_the_ends() -> None:
    values = np.random.default_rng(1).normal(size=29)
    assert np.allclose(maps.smooth(values), uniform_filter1d(values, 3)[1:-1], atol=1e-15)


def test_bins_average_what_lies_nearest_to_each_grid_point() -> None:
    theta = np.linspace(2.0, -5.0, 70_001)
    binned = maps.binned(theta, theta)
    # a linear function's mean in a symmetric bin is its centre; the end bins are halves
    assert np.allclose(binned[1:-1], maps.grid()[1:-1], atol=1e-4)
    assert binned[0] == pytest.approx(2.0 - 0.25 / 4.0, abs=1e-3)


def test_a_ramp_falls_from_two_to_minus_five_after_settling() -> None:
    theta, r = maps.ramp(override(Case(), {"cost": "raw"}), 50.0)
    assert theta.size == r.size == 10_000
    assert (theta[0], theta[-1]) == (2.0, -5.0)
    assert r.min() > 0.0  # settled: the detector's first zeros are left out
