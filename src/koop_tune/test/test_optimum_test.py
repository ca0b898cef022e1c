"""The test for an optimum inside, against monotone fits by non-negative least squares."""

import numpy as np
import pytest
from scipy.optimize import nnls

from koop_tune.excitation.optimum_test import OptimumTest, clarity, nearest_valley, weigh

TEST = OptimumTest()


def misfit(y, error, signs):
    """Return chi-squared of the nearest curve whose i-th step has the i-th sign: NNLS."""
    steps = np.tril(np.ones((y.size, y.size)))[:, 1:] * np.asarray(signs)
    terms = np.column_stack([np.ones(y.size), -np.ones(y.size), steps]) / error[:, None]
    return nnls(terms, y / error)[1] ** 2


@pytest.mark.parametrize("seed", range(6))
def test_the_evidence_is_by_how_much_the_nearest_slope_fits_worse(seed):
    rng = np.random.default_rng(seed)
    y, error = rng.normal(size=8), rng.uniform(0.1, 0.4, 8)
    falling, rising = misfit(y, error, [-1] * 7), misfit(y, error, [1] * 7)
    # the step from the falling to the rising part may have either sign
    valley = min(
        misfit(y, error, [-1] * k + [sign] + [1] * (6 - k)) for k in range(7) for sign in (-1, 1)
    )
    evidence = weigh(y, error)
    assert evidence.gain == pytest.approx(min(falling, rising) - valley, abs=1e-6)
    assert evidence.rising == (rising < falling)
    nearest = nearest_valley(y, error)
    assert (((y - nearest) / error) ** 2).sum() == pytest.approx(valley, abs=1e-6)


def test_nothing_but_a_valley_is_taken_for_one():
    """At 12 in chi-squared at most a few of a thousand maps without an optimum show one."""
    rng, u, error = np.random.default_rng(1), np.linspace(0.0, 1.0, 9), np.full(9, 0.1)

    def share(curve):
        drawn = curve + rng.normal(0.0, 0.1, (300, 9))
        return np.mean([weigh(y, error).gain > TEST.gain for y in drawn])

    assert share(4.0 * (u - 0.5) ** 2) > 0.99
    for slope in (u, -u, 0.0 * u, np.maximum(u, 0.5)):
        assert share(slope) <= 0.01


def test_chi_squared_about_a_constant_is_that_of_its_degrees_of_freedom():
    rng, error = np.random.default_rng(2), np.linspace(0.1, 0.5, 9)
    drawn = [clarity(3.0 + rng.normal(0.0, error), error) for _ in range(2000)]
    assert np.mean(drawn) == pytest.approx(8.0, rel=0.05)
    assert np.var(drawn) == pytest.approx(16.0, rel=0.15)
    flat = [TEST.is_flat(3.0 + rng.normal(0.0, error), error) for _ in range(500)]
    assert np.mean(flat) > 0.99  # 25 is the 99.8th percentile


def test_an_end_is_called_the_best_only_beyond_doubt():
    error = np.full(5, 0.1)
    assert TEST.best_end(np.array([0.0, 0.4, 0.8, 1.2, 1.6]), error) == 0
    assert TEST.best_end(np.array([1.6, 1.2, 0.8, 0.4, 0.0]), error) == 4
    assert TEST.best_end(np.array([0.0, 0.02, 0.2, 1.0, 2.0]), error) is None
    assert TEST.best_end(np.array([0.1, 0.0, 0.8, 1.2, 1.6]), error) is None
    assert OptimumTest(end=0.0).best_end(np.array([0.0, 0.02, 0.2, 1.0, 2.0]), error) == 0


def test_more_visits_are_asked_for_where_they_decide_whether_there_is_an_optimum():
    u, error = np.linspace(0.0, 1.0, 9), np.full(9, 0.05)
    assert TEST.undecided((u - 0.5) ** 2 * 4.0, error) == []  # there is one
    assert TEST.undecided(2.0 * u, error) == []  # there is none: the end is the best by far
    assert TEST.undecided(0.0 * u, error) == []  # theta does nothing
    slight = np.where(u > 0.2, u - 0.2, 0.3 * (0.2 - u)) * 2.0
    assert TEST.undecided(slight, error) == [0, 1]
    assert TEST.undecided(slight[::-1], error) == [7, 8]
    assert TEST.undecided(slight, 0.1 * error) == []
