"""Time constants and surrogates, against random processes and filters that are known exactly."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from surrogate_rigs import DT, make_dwells, make_surrogate

from koop_core.stream.arrival import Arrival
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation.static_map import StaticMap
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import Rest
from koop_tune.rig_model.fluctuation import estimate_autocovariance, fit_fluctuation
from koop_tune.rig_model.surrogate import (
    BLOCKS,
    Times,
    _follow,
    fit_times,
    high_pass,
    run,
)
from koopman_lifter import cost
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig


@pytest.mark.parametrize("tau", [2.0, 8.0])
def test_the_time_constant_of_what_noise_drives_is_that_of_its_process(tau):
    """A complex Ornstein-Uhlenbeck process, exactly sampled; measurement noise, drifting levels."""
    window, per, rng = 1.0, 50, np.random.default_rng(1)
    keep = math.exp(-window / per / tau)
    rests, amplitude = [], []
    for level in [*range(9), *range(9)]:
        steps = per * 120
        white = rng.normal(size=(2, steps)) * math.sqrt((1.0 - keep**2) / 2.0)
        z = lfilter([1.0], [1.0, -keep], white, axis=1) * rng.uniform(0.8, 1.25)
        power = (z**2).sum(axis=0).reshape(-1, per).mean(axis=1) * (1.0 + 0.2 * level)
        amplitude.append(0.5 * np.log(power + 0.05 * rng.chisquare(2, power.size)))
        rests.append(Rest(level, 0, steps, 0))
    actual = fit_fluctuation(make_dwells(rests, amplitude, per, window / per))
    assert 0.6 * tau < actual.time < 1.4 * tau
    assert actual.share > 0.3


def test_the_autocovariance_of_pieces_is_the_mean_of_their_products():
    parts = [np.random.default_rng(i).normal(size=n) for i, n in enumerate((40, 7, 3))]
    actual, pairs = estimate_autocovariance(parts, 10)
    for lag in range(10):
        products = [part[i] * part[i + lag] for part in parts for i in range(part.size - lag)]
        assert pairs[lag] == len(products)
        assert actual[lag] == pytest.approx(np.mean(products))


def test_the_high_pass_filter_is_that_of_the_nodes_detector():
    omega_h, t = 4.0, np.arange(4000) * DT
    y = 3.0 + np.random.default_rng(0).normal(size=t.size)
    loaded = Loaded(y[None], np.isin(np.arange(t.size), (0, 2000)), None, t)
    actual = high_pass(y, loaded, omega_h, DT)
    # the low-pass filter of such a detector has no memory: its cost is the square of y_hp
    detector = cost.detector_params(omega_h, 1e4, DT)
    state = cost.initial()
    for k, value in enumerate(y[:2000]):
        r, state = cost.follow(detector, state, Arrival.RESTART if k == 0 else Arrival.NEXT, value)
        assert r == pytest.approx(actual[k] ** 2, rel=1e-9, abs=1e-15)
    assert actual[2000] == 0.0  # it begins anew behind a gap


def test_unusable_samples_do_not_spread_through_the_high_pass_filter():
    y = np.full(1000, 2.0)
    y[[0, 1, 500]] = math.nan
    loaded = Loaded(y[None], np.arange(1000) == 0, None, y)
    assert high_pass(y, loaded, 4.0, DT) == pytest.approx(np.zeros(1000))


@pytest.mark.parametrize("times", [Times(1.0, 0.0, 0.0, 0.0), Times(1.0, -0.4, 0.3, 0.5)])
def test_the_amplitude_follows_its_target_as_the_equation_says(times):
    target = np.repeat([0.0, 2.0, -1.0], 2000)
    begins = np.zeros(target.size, bool)
    begins[0] = True
    actual = np.empty(target.size)
    _follow(target, begins, DT, times, actual)

    def rate(t, a):
        aim = target[min(int(t / DT), target.size - 1)]
        return (aim - a) / times.tau(aim, aim > a[0])

    at = np.arange(1, target.size) * DT
    exact = solve_ivp(rate, (0.0, at[-1]), [0.0], t_eval=at, max_step=DT, rtol=1e-6).y[0]
    assert actual[:-1] == pytest.approx(exact, abs=0.02)


def test_the_time_constant_is_found_in_how_the_windows_follow_theta():
    tau, values, rest, window = 12.0, np.linspace(0.0, 1.0, 9), 4000, 100
    scale, order = Scale(0.0, 1.0), [*range(9), *range(7, -1, -1)]
    theta = np.repeat(values[order], rest)
    level = 2.0 * (theta - 0.4) ** 2
    keep = math.exp(-DT / tau)
    a = lfilter([1.0 - keep], [1.0, -keep], level - level[0])[...] + level[0]
    noise = np.random.default_rng(0).normal(0.0, 0.01, a.size // window)
    windows = a.reshape(-1, window).mean(axis=1) + noise
    per = rest // window
    rests = [Rest(i, k * rest, (k + 1) * rest, per // 2) for k, i in enumerate(order)]
    amplitude = [windows[k * per : (k + 1) * per] for k in range(len(order))]
    dwells = make_dwells(rests, amplitude, window, DT)
    begins = np.arange(theta.size) == 0
    loaded = Loaded(a[None], begins, theta, np.arange(theta.size) * DT)
    y = 2.0 * (values - 0.4) ** 2
    actual = StaticMap(values, y, np.full(9, 0.01), 1.0)
    times = fit_times(loaded, dwells, actual, scale, DT)
    for up in (True, False):
        assert times.tau(float(np.mean(y)), up) == pytest.approx(tau, rel=0.25)


def closed(rig, esc, steps=20_000, drift=0.0, start=0.0):
    detector = LifterConfig(omega_h=10.0, omega_l=0.7, dt=DT).detector_params()
    u, power = np.empty(BLOCKS), np.empty(BLOCKS)
    draws = np.random.default_rng(1).random(1021)
    run(
        rig, detector, esc.params(DT), esc.initial(), steps, drift, start, draws, u, power,
        esc.barrier(DT), 0.0,
    )  # fmt: skip
    return u, power


def esc_config(**changes):
    settings = {
        "step_size": 5e-4, "dwell": 4.5, "tau_f": 2.0, "theta_min": 0.0, "theta_max": 1.0,
        "theta_initial": 0.0, "rate_limit": 1.0,
    }  # fmt: skip
    return EscConfig(**(settings | changes))


def test_the_amplitude_of_a_surrogate_is_that_of_its_map():
    def level(u):
        return 0.0 * u + 0.7

    _, power = closed(make_surrogate(level), esc_config())
    assert power == pytest.approx(np.full(BLOCKS, math.exp(1.4)))


def test_the_loop_seeks_the_optimum_of_a_surrogate_and_follows_it_when_it_moves():
    def level(u):
        return 3.0 * np.abs(u - 0.6)

    rig = make_surrogate(level)
    u, power = closed(rig, esc_config())
    assert u[BLOCKS // 2 :].mean() == pytest.approx(0.6, abs=0.05)
    assert power[-1] < power[0] / 8.0
    worst, _ = closed(rig, esc_config(objective="maximise", theta_initial=0.5))
    assert abs(worst[BLOCKS // 2 :] - 0.6).mean() > 0.3
    steps = 20_000
    moved, _ = closed(rig, esc_config(), steps, drift=-0.2 / steps)
    assert moved[BLOCKS // 2 :].mean() == pytest.approx(0.6, abs=0.08)
    still = esc_config(step_size=1e-12, theta_initial=0.5)
    away, power = closed(rig, still, steps, drift=-0.2 / steps, start=0.5)
    # u is theta's position as the optimum sees it
    assert away == pytest.approx(np.linspace(0.5, 0.7, BLOCKS), abs=0.002)
    assert 0.5 * np.log(power).min() < 0.02  # the optimum came by


def test_a_rig_that_settled_elsewhere_comes_to_its_level_with_its_time_constant():
    def level(u):
        return -2.0 * u

    still = esc_config(step_size=1e-12, theta_initial=1.0, rate_limit=1e-9)
    _, power = closed(make_surrogate(level, tau=20.0), still, start=0.0)
    t = (np.arange(BLOCKS) + 0.5) * 20_000 * DT / BLOCKS
    assert 0.5 * np.log(power) == pytest.approx(-2.0 * (1.0 - np.exp(-t / 20.0)), abs=0.01)
