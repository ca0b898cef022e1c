"""Windows at one value of theta: levels, errors and settling, against known random processes."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from koop_tune.excitation.visits import (
    count_alike,
    mean_level,
    standard_error,
    summarise,
)


def autoregressive(rho, shape, rng):
    """Return a stationary first-order process of unit variance, exactly sampled."""
    noise = rng.normal(size=shape) * math.sqrt(1.0 - rho**2)
    noise[0] = rng.normal(size=shape[1:])
    return lfilter([1.0], [1.0, -rho], noise, axis=0)


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.98])
def test_the_error_of_a_mean_counts_that_neighbours_are_alike(rho):
    series = autoregressive(rho, (1000, 400), np.random.default_rng(3))
    found = np.median(standard_error(series))
    assert 0.7 * series.mean(axis=0).std() < found < 1.3 * series.mean(axis=0).std()
    # s = (1 + rho) / (1 - rho) of such a process
    assert np.median(count_alike(series)) == pytest.approx((1 + rho) / (1 - rho), rel=0.35)


def test_too_few_windows_tell_no_error():
    assert standard_error(np.ones((2, 1)))[0] == math.inf
    assert count_alike(np.arange(9.0)[:, None])[0] == 3.0  # a third of them at most


def test_a_level_is_that_of_the_power_whatever_the_amplitude_does_in_a_window():
    rng = np.random.default_rng(4)
    power = rng.exponential(4.0, (20_000, 1))  # of a noise-driven oscillation of rms 2
    mean, error = mean_level(0.5 * np.log(power))
    assert mean[0] == pytest.approx(math.log(2.0), abs=4.0 * error[0])
    assert error[0] == pytest.approx(0.5 / math.sqrt(20_000), rel=0.2)


def test_windows_in_which_the_rig_settled_are_left_out():
    rng, k = np.random.default_rng(5), np.arange(80)
    noise = rng.normal(0.0, 0.02, (80, 2))
    settling = 3.0 * np.exp(-k / 4.0)
    series = noise + np.column_stack([settling, 0.0 * k])
    summary = summarise(series, [0])
    assert summary.settled
    assert 12 <= summary.skip <= 30  # 3 exp(-k / 4) is 0.15 at 12, 0.0017 at 30
    assert summary.mean == pytest.approx([0.0, 0.0], abs=0.03)
    assert summarise(series, [1]).skip < summary.skip  # another channel guides
    slow = 3.0 * np.exp(-k / 40.0)
    assert not summarise(noise + slow[:, None], [0]).settled
