"""The spread of the eigenvalues against what theory says about it, and what it is drawn from."""

import numpy as np
import pytest

from koopman_lifter.bootstrap import eigenvalue_spread
from koopman_lifter.edmd import STRETCHES, Gram, edmd, max_stretches
from koopman_lifter.modes import decompose
from koopman_lifter.observables import Monomials


def autoregression(factor, count, rng):
    """x_{k+1} = factor x_k + e_k, from its stationary distribution, shape (1, count)."""
    x = np.empty((1, count))
    x[0, 0] = rng.normal() / np.sqrt(1.0 - factor**2)
    for k, noise in enumerate(rng.normal(size=count - 1)):
        x[0, k + 1] = factor * x[0, k] + noise
    return x


def spread(gram, **given):
    return eigenvalue_spread(gram, decompose(edmd(gram), gram).eigenvalues, edmd, **given)


@pytest.mark.parametrize("factor", [0.5, 0.95])
def test_the_spread_is_that_of_an_autoregression(factor):
    """The least-squares factor has the variance (1 - factor^2) / M (Mann and Wald 1943)."""
    gram = Gram.empty(Monomials(1, 1))
    gram.add_trajectory(autoregression(factor, 30_001, np.random.default_rng(0)), longest=500)
    constant, found = spread(gram, resamples=200)
    # 60 stretches know a deviation to 9 %
    assert found == pytest.approx(np.sqrt((1.0 - factor**2) / 30_000), rel=0.3)
    assert constant < 1e-12


def test_a_pair_has_one_spread_and_the_same_data_give_the_same_figures():
    rng = np.random.default_rng(1)
    turn = 0.98 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    x = np.zeros((2, 4001))
    for k in range(4000):
        x[:, k + 1] = turn @ x[:, k] + rng.normal(size=2)
    gram = Gram.empty(Monomials(2, 1))
    gram.add_trajectory(x, longest=200)
    found = spread(gram)
    assert found[1] == found[2]
    assert 1e-3 < found[1] < 1e-2  # sqrt((1 - 0.98^2) / 4000) = 3e-3
    np.testing.assert_array_equal(found, spread(gram))
    assert found[1] != spread(gram, seed=1)[1]


def test_stretches_are_consecutive_complete_and_few_however_long_the_recording():
    rng = np.random.default_rng(2)
    observables = Monomials(2, 2)
    data = [rng.normal(size=(2, int(size))) for size in rng.integers(2, 40, 500)]
    gram = Gram.empty(observables)
    for states in data:
        gram.add_trajectory(states)
    assert STRETCHES // 2 <= len(gram.stretches) <= STRETCHES
    ends = np.cumsum([states.shape[1] - 1 for states in data])
    begin = 0
    for stretch in gram.stretches:
        end = int(np.searchsorted(ends, stretch.pairs + (ends[begin - 1] if begin else 0))) + 1
        alone = Gram.empty(observables)
        for states in data[begin:end]:
            alone.add_trajectory(states)
        assert alone.pairs == stretch.pairs
        for name in ("xx", "yx", "yy"):
            np.testing.assert_allclose(getattr(stretch, name), getattr(alone, name), rtol=1e-12)
        begin = end
    assert begin == len(data)


def test_stretches_of_two_machines_are_those_of_both():
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(2):
        gram = Gram.empty(Monomials(1, 1))
        gram.add_trajectory(autoregression(0.9, 2001, rng), longest=40)
        parts.append(gram)
    both = parts[0] + parts[1]
    assert 32 <= len(both.stretches) <= 64
    assert sum(stretch.pairs for stretch in both.stretches) == both.pairs == 4000
    assert sum(stretch.pairs for stretch in parts[0].stretches) == 2000  # they stay as they are
    assert spread(both)[1] == pytest.approx(np.sqrt((1 - 0.9**2) / 4000), rel=0.4)


def test_fewer_stretches_are_kept_of_many_observables():
    assert max_stretches(10) == 64
    assert max_stretches(969) * 3 * 8 * 969**2 < 2**28
    assert max_stretches(4000) == 8


def test_a_spread_that_the_data_cannot_tell_is_not_told():
    gram = Gram.empty(Monomials(1, 1))
    gram.add_trajectory(autoregression(0.9, 700, np.random.default_rng(4)), longest=100)
    assert spread(gram) is None  # 7 stretches
    few = Gram.empty(Monomials(2, 3))
    for _ in range(10):  # no 10 observables are excited by some of the ten points
        few.add_trajectory(np.random.default_rng(5).normal(size=(2, 2)))
    assert eigenvalue_spread(few, np.ones(10, complex), edmd) is None
