"""Channels and spectra, against sines that are known exactly."""

import math

import numpy as np
import pytest

from koop_tune.excitation.channels import (
    describe_channel,
    find_lines,
    pick_lines,
    should_listen,
    strongest_period,
)

DT = 0.01
T = np.arange(6000) * DT


def test_a_spectrum_names_frequency_and_amplitude_of_each_sine():
    noise = np.random.default_rng(0).normal(0.0, 0.1, T.size)
    x = 7.0 + 3.0 * np.sin(2 * np.pi * 1.7 * T) + 0.8 * np.sin(2 * np.pi * 6.3 * T) + noise
    peaks = find_lines(x, DT)
    assert [line.frequency for line in peaks] == pytest.approx([1.7, 6.3], abs=0.02)
    assert [line.amplitude for line in peaks] == pytest.approx([3.0, 0.8], rel=0.03)
    assert strongest_period(x[:, None], DT) == pytest.approx(1 / 1.7, rel=0.01)
    assert find_lines(np.ones(500), DT) == []


@pytest.mark.parametrize("quantum", [0.0, 0.05])
def test_a_stop_is_distinguished_from_the_turning_point_of_a_sine(quantum):
    x = 2.0 * np.sin(2 * np.pi * 1.3 * T)
    x = np.round(x / quantum) * quantum if quantum else x
    assert describe_channel(x).saturated == 0.0
    stopped = describe_channel(np.minimum(x, 1.5))
    assert stopped.saturated == pytest.approx(math.acos(0.75) / math.pi, abs=0.02)  # of a sine
    assert stopped.quantum == pytest.approx(quantum)


def test_a_channel_that_says_nothing_or_rests_is_seen():
    x = np.sin(T)
    assert describe_channel(np.full(100, 3.0)).dead
    assert describe_channel(np.full(100, math.nan)).dead
    assert describe_channel(np.r_[x[:3000], np.full(3000, x[2999])]).held == pytest.approx(
        0.5, abs=0.01
    )
    assert describe_channel(np.where(T < 6.0, math.nan, x)).bad == pytest.approx(0.1)


def test_listening_ends_after_some_periods_or_at_the_limit():
    x = np.sin(2 * np.pi * 2.0 * T)[:, None]

    def wanted(seconds, periods=10.0, longest=50.0):
        return should_listen(x[: round(seconds / DT)], DT, 2.0, periods, longest)

    assert wanted(1.0)  # shorter than the least
    assert wanted(4.0)  # of ten periods of 0.5 s
    assert not wanted(5.5)
    assert not wanted(20.0, 1000.0, 10.0)


def test_lines_are_picked_from_a_spectrum_that_stand_out_from_what_is_around():
    frequency = np.arange(200) * 0.1
    power = np.full(200, 1e-3)
    power[[49, 50, 51]] = [0.5, 1.0, 0.5]  # under a Hann window
    power[[119, 120, 121]] = [0.05, 0.1, 0.05]
    power[[149, 150, 151]] = [2e-3, 4e-3, 2e-3]  # hardly above its surroundings
    strongest, other = pick_lines(frequency, power)
    assert (strongest.frequency, other.frequency) == pytest.approx((5.0, 12.0))
    assert strongest.amplitude == pytest.approx(math.sqrt(2.0 * 2.0 / 1.5), rel=0.01)
    assert strongest.share == pytest.approx(10.0 * other.share, rel=0.1)
