"""The figures of merit against costs whose quality is known."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from koop_core.stream.arrival import Arrival
from koop_identify.model.merit import cut_windows, detected, merit, oscillation, settled_windows
from koopman_lifter import cost

DT, DWELL = 0.1, 5.0
K, L = 400, 200


def static_map(noise, seed=0, optimum=1.0):
    """Windows at random theta; r is |theta - optimum| plus white noise, the amplitude exact."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-5.0, 5.0, K)
    amplitude = np.abs(theta - optimum)
    r = amplitude[:, None] + noise * rng.standard_normal((K, L))
    return r, amplitude, theta


def test_a_cost_that_rises_with_the_oscillation_is_perfect_whatever_its_scale():
    r, amplitude, theta = static_map(0.0)
    for of_r in (lambda r: r, lambda r: 1e20 * r**5, np.sqrt):
        found = merit(of_r(r), amplitude, theta, DT, DWELL, swing=1.0)
        assert found.rank_amplitude == pytest.approx(1.0)
        assert found.rank_theta > 0.99
        assert found.right > 0.95  # a tenth of the windows tells the optimum to 0.2
        assert abs(found.theta_offset) < 1e-9
    assert merit(-r, amplitude, theta, DT, DWELL, swing=1.0).right < 0.05


def test_noise_alone_is_chance():
    _, amplitude, theta = static_map(0.0)
    r = np.random.default_rng(1).standard_normal((K, L))
    found = merit(r, amplitude, theta, DT, DWELL)
    assert abs(found.rank_amplitude) < 0.15  # 3 / sqrt(K)
    assert found.right == pytest.approx(0.5, abs=0.05)
    assert abs(found.snr) < 0.2


@pytest.mark.parametrize("with_theta", [True, False])
def test_the_signal_to_noise_ratio_is_that_of_the_means_over_one_dwell(with_theta):
    """Means over n samples differ by the step and scatter by noise / sqrt(n)."""
    noise = 10.0
    r, amplitude, theta = static_map(noise, optimum=-5.0)
    found = merit(r, amplitude, theta if with_theta else None, DT, DWELL, swing=1.0)
    n = DWELL / DT
    expected = 1.0 / (noise / math.sqrt(n))
    # steps from half to one and a half are pooled: Phi is not straight, hence the tolerance
    assert found.snr == pytest.approx(expected, rel=0.15)
    assert found.right == pytest.approx(norm.cdf(expected / math.sqrt(2.0)), abs=0.03)
    assert found.dwell == DWELL


def test_a_cost_whose_least_lies_elsewhere_is_told():
    r, _, theta = static_map(0.0, optimum=3.0)
    found = merit(r, np.abs(theta + 2.0), theta, DT, DWELL)
    assert found.theta_least_amplitude == pytest.approx(-2.0, abs=0.2)
    assert found.theta_least_r == pytest.approx(3.0, abs=0.2)
    assert found.theta_offset == pytest.approx(5.0, abs=0.3)


def test_windows_without_a_cost_or_without_theta_are_left_out():
    r, amplitude, theta = static_map(0.1)
    r[:100], theta[100:150] = np.nan, np.nan
    assert merit(r, amplitude, theta, DT, DWELL).windows == K - 150
    assert merit(r[:101], amplitude[:101], theta[:101], DT, DWELL).rank_amplitude is None


# -- windows ------------------------------------------------------------------------------------


def begin(size, *others):
    begins = np.zeros(size, bool)
    begins[[0, *others]] = True
    return begins


def test_windows_begin_after_the_skip_and_hold_no_jump():
    theta = np.repeat([0.0, 4.0, -3.0, 1.0], 300)
    starts, length = settled_windows(theta, begin(1200), DT, 10.0)
    assert (starts.tolist(), length) == ([100, 400, 700, 1000], 190)
    shorter, length = settled_windows(theta, begin(1200), DT, 10.0, longest=9.0)
    assert (shorter.tolist(), length) == ([100, 190, 400, 490, 700, 790, 1000, 1090], 90)


def test_a_gap_ends_a_window_as_a_jump_does():
    theta = np.repeat([0.0, 4.0], 300)
    starts, length = settled_windows(theta, begin(600, 150), DT, 10.0)
    assert starts.tolist() == [400]  # what is left of the others is shorter
    assert length == 190


def test_where_theta_always_moves_it_moves_by_a_tenth_within_a_window():
    theta = 5.0 * np.abs(np.arange(2000) % 400 - 200) / 200  # a triangle from 5 to 0 and back
    starts, length = settled_windows(theta, begin(2000), DT, 1.0)
    assert length == pytest.approx(20, abs=1)
    assert np.ptp(cut_windows(theta, starts, length), axis=1).max() < 0.6


def test_without_theta_the_data_are_cut_into_equal_parts():
    starts, length = settled_windows(None, begin(2100), DT, 10.0)
    assert (starts[0], length, starts.size) == (100, 100, 20)


def test_nothing_settled_means_no_windows():
    assert settled_windows(None, begin(50), DT, 10.0)[0].size == 0


def test_units_do_not_matter_to_the_oscillation():
    rng = np.random.default_rng(2)
    x = np.repeat(rng.uniform(1.0, 2.0, 20), 100) * np.sin(np.arange(2000))
    starts = np.arange(20) * 100
    one = oscillation(np.stack((x, x)), starts, 100)
    np.testing.assert_allclose(oscillation(np.stack((x, 1e6 * x)), starts, 100), one, rtol=1e-9)
    assert oscillation(np.zeros((1, 2000)), starts, 100).tolist() == [0.0] * 20


def test_the_detector_answers_as_in_the_lifter_that_joins_at_every_begin():
    rng = np.random.default_rng(3)
    y_out = rng.uniform(0.0, 2.0, 1000)
    params = cost.detector_params(20.0, 3.0, 0.02)
    r = detected(y_out, begin(1000, 600), params)
    state = cost.initial()
    for k in range(1000):
        arrival = int(Arrival.JOIN) if k in (0, 600) else int(Arrival.NEXT)
        expected, state = cost.follow(params, state, arrival, y_out[k])
        assert r[k] == expected or (math.isnan(r[k]) and math.isnan(expected))
    settling = params.settling
    assert np.isnan(r[:settling]).all()
    assert np.isfinite(r[settling + 1 : 600]).all()
    assert np.isnan(r[600 : 600 + settling]).all()
