"""Static maps: against known functions, and a Gaussian process that is worked out by hand."""

import math

import numpy as np
import pytest
from surrogate_rigs import make_map

from koop_tune.excitation.static_map import GRID, MAP, StaticMap

GOOD = math.log(1.5)
FINE = np.linspace(0.0, 1.0, 33)


def vee(u):
    return 5.0 * np.abs(u - 0.375)


def posterior(found, places):
    """Return mean and covariance at places: Rasmussen and Williams (2006), eq. 2.23 and 2.24.

    The Matern kernel of nu = 3/2 is written out (eq. 4.17); its constants are those of the fit.
    """
    kernel = found._fit[0].kernel_
    amplitude, length = kernel.k1.k1.constant_value, kernel.k1.k2.length_scale
    white = kernel.k2.noise_level

    def k(a, b):
        r = math.sqrt(3.0) * np.abs(a[:, None] - b[None]) / length
        return amplitude * (1.0 + r) * np.exp(-r)

    noise = np.diag(np.maximum(found.error, MAP.least_error) ** 2 + white)
    gain = np.linalg.solve(k(found.u, found.u) + noise, k(found.u, places)).T
    mean = found.y.mean() + gain @ (found.y - found.y.mean())
    return mean, k(places, places) - gain @ k(found.u, places)


@pytest.fixture(scope="module")
def noisy():
    rng = np.random.default_rng(0)
    u = np.r_[np.linspace(0.0, 1.0, 9), 0.4, 0.45, 0.37]
    y = vee(u) + rng.normal(0.0, 0.2, u.size)
    return StaticMap(u, y, np.full(u.size, 0.2), 1.0)


def test_the_curve_and_its_error_are_the_posterior_of_the_process(noisy):
    mean, covariance = posterior(noisy, noisy.grid[::32])
    assert noisy.curve[::32] == pytest.approx(mean, abs=1e-6)
    assert noisy.deviation[::32] == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-4)
    step, error = noisy.difference(0.1, 0.8)
    mean, covariance = posterior(noisy, np.array([0.1, 0.8]))
    contrast = np.array([1.0, -1.0])
    assert (step, error**2) == pytest.approx(
        (contrast @ mean, contrast @ covariance @ contrast), rel=1e-4
    )


def test_maps_that_are_drawn_have_the_covariance_of_the_process(noisy):
    drawn = noisy.draw(np.random.default_rng(1).standard_normal((4000, GRID)))
    at = np.arange(0, GRID, 128)  # on the coarse grid: nothing is interpolated
    mean, covariance = posterior(noisy, noisy.grid[at])
    deviation = np.sqrt(np.diag(covariance))
    correlation = np.corrcoef(drawn[:, at].T)
    assert drawn[:, at].mean(axis=0) == pytest.approx(mean, abs=0.06 * deviation.max())
    assert drawn[:, at].std(axis=0) == pytest.approx(deviation, rel=0.05)
    assert correlation == pytest.approx(covariance / np.outer(deviation, deviation), abs=0.06)
    # the error of a difference is the spread of the drawn ones
    step, error = noisy.difference(noisy.grid[at[1]], noisy.grid[at[6]])
    steps = drawn[:, at[1]] - drawn[:, at[6]]
    assert (steps.mean(), steps.std()) == pytest.approx((step, error), rel=0.05)
    middle = noisy.draw(np.zeros((1, GRID)))[0]
    assert middle[at] == pytest.approx(noisy.curve[at], abs=1e-6)


def test_drawn_maps_of_what_is_to_be_large_have_its_sign(noisy):
    turned = StaticMap(noisy.u, -noisy.mean, noisy.error, -1.0)
    normal = np.random.default_rng(2).standard_normal((3, GRID))
    assert turned.draw(normal) == pytest.approx(-noisy.draw(normal), abs=1e-6)
    assert turned.curve == pytest.approx(-noisy.curve, abs=1e-6)
    assert turned.best() == noisy.best()


def test_the_expected_improvement_is_that_of_the_drawn_values(noisy):
    u = np.array([0.05, 0.35, 0.42])
    y, deviation = noisy.predict(u)
    values = y + deviation * np.random.default_rng(3).standard_normal((400_000, 3))
    gain = np.maximum(noisy.least - values, 0.0).mean(axis=0)
    assert noisy.expected_improvement(u) == pytest.approx(gain, rel=0.03, abs=1e-4)
    floor = noisy.least - 0.02
    seen = np.maximum(noisy.least - np.maximum(values, floor), 0.0).mean(axis=0)
    assert noisy.expected_improvement(u, floor) == pytest.approx(seen, rel=0.03, abs=1e-4)
    assert noisy.expected_improvement(u, noisy.least + 0.1) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_best_valley_and_ends_of_a_sharp_map_are_those_of_its_function(sense):
    found = make_map(lambda u: sense * vee(u), 0.01, sense, FINE)
    assert found.best() == 0.375  # 3/8 is a hold
    assert found.least == pytest.approx(0.0, abs=0.03)  # a kink is rounded off
    assert found.valley() == pytest.approx((0.375 - GOOD / 5.0, 0.375 + GOOD / 5.0), abs=0.006)
    factor = math.exp(0.5)
    assert found.valley(factor) == pytest.approx((0.275, 0.475), abs=0.006)
    for end in (0.0, 1.0):
        assert found.worse_by(end)[0] == pytest.approx(vee(end), abs=0.04)
    assert found.interior
    assert not found.flat
    assert found.best_end is None
    least = min(found.worse_by(0.0)[1], found.worse_by(1.0)[1])
    assert found.evidence == pytest.approx(least**2)
    # by hand: two values with errors of 0.01 each
    assert found.evidence == pytest.approx((vee(0.0) / math.hypot(0.01, 0.01)) ** 2, rel=0.5)


def test_the_best_is_a_hold_not_what_the_curve_makes_of_the_space_between():
    u = np.array([0.0, 0.3, 0.5, 1.0])
    found = make_map(lambda v: 4.0 * np.abs(v - 0.42), 0.01, u=u)
    assert found.best() in u
    assert found.best() == 0.5
    assert found.valley().low <= 0.5 <= found.valley().high


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_between_two_holds_a_better_one_may_be_hidden(sense):
    def valley(u):  # its floor, 0, lies between two of nine holds
        return sense * np.minimum(np.abs(u - 0.4375) * 20.0, 2.0)

    found = make_map(valley, 0.01, sense)
    assert found.least == pytest.approx(1.25, abs=0.1)
    at_best = found.deviation[round(found.best() * (GRID - 1))]
    assert found.doubt > 10.0 * at_best
    close = make_map(valley, 0.01, sense, np.r_[np.linspace(0.0, 1.0, 9), 0.425, 0.4375, 0.45])
    assert close.doubt < 0.5 * found.doubt


@pytest.mark.parametrize("slope", [3.0, -3.0])
def test_a_monotone_map_has_its_best_at_an_end_and_no_optimum_inside(slope):
    found = make_map(lambda u: slope * u, 0.03)
    end = 0.0 if slope > 0.0 else 1.0
    assert (found.best(), found.best_end) == (end, end)
    assert found.worse_by(end) == (0.0, 0.0)
    assert not found.interior
    assert found.evidence == 0.0


def test_noise_alone_is_flat_and_chi_squared_is_that_of_a_constant():
    rng = np.random.default_rng(4)
    u, error = np.linspace(0.0, 1.0, 9), np.full(9, 0.1)
    maps = [StaticMap(u, rng.normal(0.0, 0.1, 9), error, 1.0) for _ in range(400)]
    values = [found.chi_squared for found in maps]
    assert np.mean([found.flat for found in maps]) > 0.99
    assert np.mean(values) == pytest.approx(8.0, rel=0.1)  # degrees of freedom
    assert np.var(values) == pytest.approx(16.0, rel=0.3)


def test_the_basin_ends_at_the_ridge_to_another_valley_but_at_no_ripple():
    def two(u):
        return np.minimum(6.0 * np.abs(u - 0.25), 0.5 + 6.0 * np.abs(u - 0.75))

    found = make_map(two, 0.01, u=FINE)
    ridge = 0.5 + 0.5 / 12.0
    assert found.best() == 0.25
    low, high = found.basin()
    assert low == pytest.approx(0.0, abs=1.5 / GRID)
    assert high == pytest.approx(ridge, abs=0.03)
    rng = np.random.default_rng(5)
    y = 2.0 * np.abs(FINE - 0.25) + rng.normal(0.0, 0.1, FINE.size)
    rippled = StaticMap(FINE, y, np.full(FINE.size, 0.1), 1.0)
    assert rippled.basin() == pytest.approx((0.0, 1.0), abs=0.01)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_cliff_has_a_good_and_a_bad_side(side, sense):
    def cliff(u):
        v = u if side > 0 else 1.0 - u
        return sense * np.where(v < 0.6, -0.3 * v, math.log(20.0))

    # no gap beside the best is wide: see koop_tune.excitation.design
    close = np.linspace(0.37, 0.59, 5)
    u = np.sort(np.r_[np.linspace(0.0, 1.0, 9), close, 1.0 - close, 0.61, 0.39])
    found = make_map(cliff, 0.02, sense, u)
    known = found.cliff(side)
    inner, outer = (0.59, 0.61) if side > 0 else (0.41, 0.39)
    assert (known.inner, known.outer) == pytest.approx((inner, outer))
    assert known.height == pytest.approx(math.log(20.0) + 0.3 * 0.59, abs=0.05)
    assert found.cliff(-side) is None


@pytest.mark.parametrize("steps", [3, 9])
def test_the_steep_side_of_a_narrow_valley_is_no_cliff(steps):
    def absorber(u):  # 40-fold within 4 % of the range, as a tuned absorber
        return np.log(np.hypot(1.0 / 40.0, np.minimum(np.abs(u - 0.42) / 0.04, 1.0)))

    beside = 0.42 + np.linspace(-0.05, 0.05, steps)
    found = make_map(absorber, 0.02, u=np.sort(np.r_[np.linspace(0.0, 1.0, 9), beside]))
    assert found.best() == pytest.approx(0.42)
    assert found.cliff(1) is None
    assert found.cliff(-1) is None


def test_a_cliff_is_a_factor_of_eight_and_a_valley_as_wide_as_is_asked():
    u = np.sort(np.r_[np.linspace(0.0, 1.0, 9), 0.59, 0.61])
    maps = [
        make_map(lambda u, jump=jump: np.where(u < 0.6, 0.0, math.log(jump)), 0.02, u=u)
        for jump in (6.0, 10.0)
    ]
    assert maps[0].cliff(1) is None
    assert maps[1].cliff(1).outer == 0.61
    wide = StaticMap(FINE, vee(FINE), np.full(FINE.size, 0.01), 1.0)
    assert wide.valley(3.0).width == pytest.approx(2.0 * math.log(3.0) / 5.0, abs=0.01)


def test_holds_that_differ_beyond_their_errors_widen_the_error_of_the_map():
    u = np.repeat(np.linspace(0.0, 1.0, 9), 2)
    apart = np.where(np.arange(18) % 2, 0.1, -0.1)  # from below and from above
    alike, torn = (StaticMap(u, vee(u) + k * apart, np.full(18, 0.01), 1.0) for k in (0.0, 1.0))
    assert alike.predict(u)[1].mean() < 0.01
    # the mean of two that scatter by 0.1
    assert torn.predict(u)[1].mean() == pytest.approx(0.1 / math.sqrt(2.0), rel=0.5)


def test_the_error_of_a_curve_holds_the_truth_nine_times_of_ten():
    rng, inside = np.random.default_rng(6), []
    u = np.linspace(0.0, 1.0, 13)
    for _ in range(8):
        best, slope = rng.uniform(0.2, 0.8), rng.uniform(2.0, 8.0)
        truth = slope * (np.sqrt((u - best) ** 2 + 0.01) - 0.1)
        found = StaticMap(u, truth + rng.normal(0.0, 0.1, u.size), np.full(u.size, 0.1), 1.0)
        exact = slope * (np.sqrt((found.grid - best) ** 2 + 0.01) - 0.1)
        inside.append(np.mean(np.abs(found.curve - exact) < 1.96 * found.deviation))
    assert np.mean(inside) > 0.85


def test_a_hold_of_which_little_is_known_is_survived():
    u = np.linspace(0.0, 1.0, 9)
    error = np.full(9, 0.02)
    error[3] = math.inf  # too short to tell
    y = np.where(u < 0.7, 0.5, 4.0)
    y[3] = -1.0
    found = StaticMap(u, y, error, 1.0)
    assert np.isfinite(found.deviation).all()
    assert found.best() < 0.7
    for side in (-1, 1):
        cliff = found.cliff(side)
        assert cliff is None or side * (cliff.outer - cliff.inner) > 0.0


@pytest.mark.parametrize("way", [0.3, -0.2, 0.0])
def test_a_map_that_moves_is_the_one_of_now_and_one_that_rests_stays(way):
    rng = np.random.default_rng(7)
    u = np.r_[np.linspace(0.0, 1.0, 6), np.linspace(0.9, 0.1, 5), rng.uniform(0.2, 0.8, 14)]
    time = np.linspace(3.0, 8.0, u.size)

    def level(u, share):
        return 3.0 * np.hypot(0.2, u - 0.5 - way * share)

    noisy = level(u, np.linspace(0.0, 1.0, u.size)) + rng.normal(0.0, 0.05, u.size)
    still = StaticMap(u, noisy, np.full(u.size, 0.05), 1.0)
    found = still.now(time)
    assert found.motion == pytest.approx(way, abs=0.03)
    if not way:
        assert found is still
        return
    inner = np.abs(found.grid - 0.5) < 0.3
    exact = level(found.grid, 1.0)
    off, before = (np.abs(each.curve - exact)[inner].max() for each in (found, still))
    assert off < 0.2 < before
    assert found.draw(np.zeros((1, GRID)))[0] == pytest.approx(found.curve, abs=0.05)


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_which_holds_an_oscillation_that_comes_and_goes_left_quiet_is_no_motion(seed):
    rng = np.random.default_rng(seed)
    u = np.r_[np.linspace(0.0, 1.0, 6), np.linspace(0.9, 0.1, 5), rng.uniform(0.2, 0.8, 14)]
    quiet = 2.5 * (rng.random(u.size) < 0.5)
    level = 3.0 * np.hypot(0.2, u - 0.5) - quiet + rng.normal(0.0, 0.3, u.size)
    still = StaticMap(u, level, np.full(u.size, 0.3), 1.0)
    assert still.now(np.linspace(3.0, 8.0, u.size)) is still
