"""Level, error and settling of a hold, against processes of which they are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from surrogate_rigs import DT, make_amplitude

from koop_tune.excitation.amplitude import Windows
from koop_tune.excitation.holds import (
    Hold,
    Level,
    count_alike,
    find_level,
    find_proven,
    longest_growth,
    mean_level,
    standard_error,
    usual_wander,
)

AMPLITUDE = make_amplitude()


def noise_driven(rho, size, rng):
    """Return the power of an oscillation that noise drives: of a complex AR(1), mean 1."""
    white = rng.normal(size=(2, size + 300)) * math.sqrt(0.5 * (1.0 - rho**2))
    return (lfilter([1.0], [1.0, -rho], white, axis=1)[:, 300:] ** 2).sum(axis=0)


def exact_error(rho, size):
    """Return the standard error of half the logarithm of the mean of that power.

    Its autocorrelation is rho^2k, its variance the square of its mean.
    """
    k = np.arange(1, size)
    return 0.5 * math.sqrt((1.0 + 2.0 * ((1.0 - k / size) * rho ** (2 * k)).sum()) / size)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_level_and_error_of_a_noise_driven_hold_are_those_of_its_process(rho):
    rng, size = np.random.default_rng(0), 400
    found = np.array([mean_level(noise_driven(rho, size, rng)) for _ in range(300)])
    exact = exact_error(rho, size)
    assert found[:, 0].std() == pytest.approx(exact, rel=0.15)  # the formula is the spread
    assert np.median(found[:, 1]) == pytest.approx(exact, rel=0.2)
    assert found[:, 0].mean() == pytest.approx(0.0, abs=0.01 + exact**2)
    assert mean_level(np.full(20, -1.0), floor=0.1)[0] == pytest.approx(math.log(0.1))


def test_windows_that_are_alike_count_once():
    rng = np.random.default_rng(1)
    values = np.repeat(rng.normal(size=(400, 1)), 4, axis=0)
    # 1 + 2 (3/4 + 2/4 + 1/4): the triangle's autocorrelation
    assert count_alike(values)[0] == pytest.approx(4.0, rel=0.25)
    assert standard_error(values)[0] == pytest.approx(0.05, rel=0.2)
    drift = np.linspace(0.0, 1.0, 30)[:, None]
    assert count_alike(drift)[0] == pytest.approx(10.0, rel=0.35)  # at most a third of them
    assert standard_error(values[:2])[0] == math.inf


def hold_logs(logs):
    return find_level(AMPLITUDE, np.exp(2.0 * np.asarray(logs)))


@pytest.mark.parametrize("step", [3.0, -3.0])
def test_the_settling_is_skipped_and_its_rise_is_told(step):
    rng, tau = np.random.default_rng(2), 8.0
    k = np.arange(120)
    level = hold_logs(-1.0 - step * np.exp(-k / tau) + rng.normal(0.0, 0.02, k.size))
    assert level.is_settled()
    assert level.mean == pytest.approx(-1.0, abs=0.02)
    # until what is left of the step is about the error of the mean
    assert 2.0 * tau < level.skip < tau * math.log(3.0 / 0.005)
    assert level.rise == pytest.approx(step, abs=0.1)
    assert level.count == 120
    flat = hold_logs(rng.normal(0.0, 0.02, 120))
    assert flat.is_settled()
    assert abs(flat.mean) < 4.0 * flat.error


def test_a_trend_is_not_settled():
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, 0.02, 80)
    assert not hold_logs(np.linspace(0.0, 1.0, 80) + noise).is_settled()
    assert not hold_logs(np.linspace(1.0, 0.0, 80) + noise).is_settled()
    slow = -3.0 * np.exp(-np.arange(80) / 60.0)  # the rig is at 1.3 of its time constants
    assert not hold_logs(slow + noise).is_settled()
    late = np.where(np.arange(80) < 60, 0.0, 2.0)  # it grows when all seemed settled
    assert not hold_logs(late + noise).is_settled()


def test_a_short_hold_is_no_surer_than_others_showed():
    squares = noise_driven(0.0, 16, np.random.default_rng(4))
    alone, told = (find_level(AMPLITUDE, squares).at_least(wander) for wander in (0.0, 9.0))
    assert told.error == pytest.approx(math.sqrt(9.0 / (16 - told.skip)))
    assert told.error > alone.error
    assert told.mean == alone.mean
    assert usual_wander([1.0, 2.0, 3.0, 4.0, 5.0, math.inf]) == 4.0
    assert usual_wander([math.inf]) == 0.0


def test_samples_that_are_appended_give_the_powers_of_all_at_once():
    x = np.random.default_rng(5).normal(size=(50 * 20, 2))
    windows, other = Windows(50, DT), Windows(125, DT)
    whole = Hold(0.3, 1, x)
    parts = Hold(0.3, 1, np.empty((0, 2)))
    for k in range(0, x.shape[0], 50):
        parts.append(x[k : k + 50])
        assert parts.powers(windows).shape[0] == k // 50 + 1
    assert parts.powers(windows) == pytest.approx(whole.powers(windows), rel=1e-12)
    assert parts.powers(other) == pytest.approx(whole.powers(other), rel=1e-12)
    ragged = Hold(0.3, 1, np.empty((0, 2)))
    for a, b in ((0, 70), (70, 120), (120, 500), (500, 1000)):
        ragged.append(x[a:b])
        ragged.powers(windows)
    assert ragged.powers(windows) == pytest.approx(whole.powers(windows), rel=1e-12)
    assert (ragged.size, ragged.x.tolist()) == (1000, x.tolist())
    assert whole.late(windows).tolist() == whole.powers(windows)[10:].tolist()


def visit(stays, edge=0.1, gain=0.25, noise=0.02):
    """Return positions, levels and truth of stays (u, windows) around a valley at 0.5.

    Beyond its edges log a grows at gain * (distance from the edge) in a window, up to 0, and decays
    at 0.1 within; of what is measured, hypot(a, noise), nothing shows at first.
    """
    log, rng, levels = 0.0, np.random.default_rng(6), []
    for u, count in stays:
        rate = gain * (abs(u - 0.5) - edge) if abs(u - 0.5) > edge else -0.1
        path = np.clip(log + rate * np.arange(1, count + 1), math.log(noise) - 1.5, 0.0)
        log = float(path[-1])
        logs = 0.5 * np.logaddexp(2.0 * path, 2.0 * math.log(noise)) + rng.normal(0.0, 0.05, count)
        levels.append(hold_logs(logs))
    u = np.array([u for u, _ in stays])
    return u, levels, np.where(np.abs(u - 0.5) > edge, 0.0, math.log(noise))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_short_hold_from_a_quiet_place_does_not_count_where_an_oscillation_may_grow(sense):
    stays = [(0.0, 20), (1.0, 20), (0.5, 200), (0.38, 20), (0.3, 250), (0.9, 12), (0.57, 120),
             (0.54, 12), (0.62, 60), (0.7, 12)]  # fmt: skip
    u, levels, truth = visit(stays)
    levels = [replace(x, mean=sense * x.mean, rise=sense * x.rise) for x in levels]
    false = np.abs(sense * np.array([x.mean for x in levels]) - truth) > 1.0
    assert set(u[false]) == {0.38, 0.62, 0.7}
    assert (find_proven(u, levels, sense) == ~false).all()


def test_holds_count_where_no_growth_was_seen_or_nothing_is_far_worse_further_out():
    def proven(*levels):
        return find_proven(np.array([0.5, 0.3, 0.1, 0.4, 0.9]), levels, 1.0).tolist()

    def level(mean, count, skip=0, rise=0.0):
        return Level(mean, 0.1, skip, count, rise, 0.0)

    quiet, short, even = level(0.0, 40), level(0.2, 8), level(3.0, 40)
    grew, slightly = level(3.0, 40, 20, 2.9), level(1.0, 40, 20, 0.9)
    assert longest_growth([quiet, grew, level(0.0, 60, 30, -3.0)], 1.0) == 20
    assert proven(quiet, short, grew, quiet, short) == [True, False, True, True, True]
    assert all(proven(quiet, short, slightly, quiet, short))
    assert all(proven(quiet, short, even, quiet, short))
    assert all(proven(level(2.0, 8), level(1.0, 8), grew, quiet, short))  # it was not quiet before
    assert find_proven(np.empty(0), [], 1.0).size == 0
