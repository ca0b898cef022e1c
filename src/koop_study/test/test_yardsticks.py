"""The maps of others have the figures of their sources, and the law reaches their optima."""

import numpy as np
import pytest

from koop_study.simulation.yardsticks import FARM, HESSIAN, YARDSTICKS, farm_power, seek_yardstick


def test_the_wind_farm_has_the_published_power():
    assert farm_power(np.full(6, 0.3)) == pytest.approx(3.4756, abs=5e-5)
    assert farm_power(FARM) == pytest.approx(3.6559, abs=5e-5)
    rng = np.random.default_rng(0)  # and that is its optimum
    near = [farm_power(FARM + rng.normal(0.0, 0.01, 6)) for _ in range(100)]
    assert max(near) < farm_power(FARM) + 1e-6


def test_the_quadratic_is_begun_along_the_eigenvectors_of_its_hessian():
    for name in ("quadratic, flat", "quadratic, steep"):
        away = YARDSTICKS[name].start - YARDSTICKS[name].best
        assert np.linalg.norm(away) == pytest.approx(np.hypot(0.5, 1.0))
        assert HESSIAN @ away == pytest.approx(away @ HESSIAN @ away / (away @ away) * away)


@pytest.mark.parametrize("name", YARDSTICKS)
def test_the_law_reaches_every_one(name):
    (row,) = seek_yardstick(name, [0])
    assert row["samples"] is not None
    map_ = YARDSTICKS[name]
    best, first = map_.cost(map_.best), map_.cost(map_.start)
    assert abs(row["cost"] - best) < 0.01 * abs(first - best)
