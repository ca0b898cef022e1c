"""The sums of a delay line, most of which are never summed, against the plain products."""

import numpy as np
import pytest

from koopman_lifter.delays import Delays
from koopman_lifter.observables import Monomials
from koopman_lifter.products import delay_line, products


def plain(observables, states):
    lifted = observables.lift(states)
    now, after = lifted[:, :-1], lifted[:, 1:]
    return now @ now.T, after @ now.T, after @ after.T


def size(sums):
    """Return the largest that an entry can be by those of the diagonal (Cauchy and Schwarz)."""
    now, _, after = (np.sqrt(np.diag(each)) for each in sums)
    return [np.outer(a, b) for a, b in ((now, now), (after, now), (after, after))]


@pytest.mark.parametrize(
    ("channels", "count", "degree"), [(1, 2, 3), (1, 5, 4), (1, 16, 2), (2, 3, 3), (3, 2, 2)]
)
def test_a_delay_line_has_the_sums_of_its_products(channels, count, degree):
    rng = np.random.default_rng(count)
    states = Delays(channels, count).embed(rng.normal(1.0, 1.0, (channels, 5000)))
    observables = Monomials(channels * count, degree)
    assert delay_line(states) == channels
    expected = plain(observables, states)
    for actual, truth, largest in zip(
        products(observables, states), expected, size(expected), strict=True
    ):
        assert (np.abs(actual - truth) / largest).max() < 1e-13


@pytest.mark.parametrize("factor", [0.999, 0.7, 0.05])
def test_a_signal_that_dies_away_loses_no_digit(factor):
    states = Delays(1, 4).embed(3.0 * factor ** np.arange(300.0)[None])
    observables = Monomials(4, 3)
    expected = plain(observables, states)
    for actual, truth, largest in zip(
        products(observables, states), expected, size(expected), strict=True
    ):
        assert (np.abs(actual - truth) / largest).max() < 1e-12


def test_only_the_past_of_the_same_channel_is_a_delay_line():
    x = np.random.default_rng(0).normal(size=(2, 60))
    assert delay_line(x) == 0
    assert delay_line(Delays(2, 3, 2).embed(x)) == 0
    assert delay_line(Delays(2, 3).embed(x)[::-1]) == 0
    late = Delays(2, 3).embed(x)
    late[4, 40] += 1.0
    assert delay_line(late) == 0
