"""The excitation offline: channels, features, dwell points, against figures known exactly."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_tune.excitation import optimum_test, progress, staircase
from koop_tune.excitation.channels import channel, lines, strongest_period
from koop_tune.excitation.features import Bands, bands, features
from koop_tune.excitation.staircase import Visit
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.stays import Scale

DT = 0.01
T = np.arange(6000) * DT
RIG = RigFile(
    "/a:x,y", "a/msg/A", "/b:z", "std_msgs/msg/Float64", DT, -1.0, 3.0, 0.5, 2.0, 0.5,
    channel_max=(5.0, 6.0),
)  # fmt: skip


def test_a_spectrum_names_frequency_and_amplitude_of_each_sine():
    noise = np.random.default_rng(0).normal(0.0, 0.1, T.size)
    x = 7.0 + 3.0 * np.sin(2 * np.pi * 1.7 * T) + 0.8 * np.sin(2 * np.pi * 6.3 * T) + noise
    found = lines(x, DT)
    assert [line.frequency for line in found] == pytest.approx([1.7, 6.3], abs=0.02)
    assert [line.amplitude for line in found] == pytest.approx([3.0, 0.8], rel=0.03)
    assert strongest_period(x[:, None], DT) == pytest.approx(1 / 1.7, rel=0.01)
    assert lines(np.ones(500), DT) == []


@pytest.mark.parametrize("levels", [0.0, 0.05])
def test_a_stop_is_told_from_a_sine_that_turns(levels):
    x = 2.0 * np.sin(2 * np.pi * 1.3 * T)
    x = np.round(x / levels) * levels if levels else x
    assert channel(x).saturated == 0.0
    held = channel(np.minimum(x, 1.5))
    assert held.saturated == pytest.approx(math.acos(0.75) / math.pi, abs=0.02)  # of a sine
    assert held.quantum == pytest.approx(levels)


def test_a_channel_that_says_nothing_or_rests_is_seen():
    x = np.sin(T)
    assert channel(np.full(100, 3.0)).dead
    assert channel(np.full(100, math.nan)).dead
    assert channel(np.r_[x[:3000], np.full(3000, x[2999])]).held == pytest.approx(0.5, abs=0.01)
    assert channel(np.where(T < 6.0, math.nan, x)).bad == pytest.approx(0.1)


def test_features_are_the_logarithms_of_amplitudes_in_all_and_in_bands():
    x = np.column_stack([2.0 * np.sin(2 * np.pi * 5.0 * T), 0.5 * np.sin(2 * np.pi * 1.5 * T)])
    how = bands(x, 400, DT)
    found = np.exp(features(x[:400], how)).reshape(2, -1)
    assert found[:, 0] == pytest.approx([2.0, 0.5], rel=0.01)
    inside = [a <= 5.0 * 4.0 < b for a, b in zip(how.edges, how.edges[1:], strict=False)]
    assert found[0, 1:][inside] == pytest.approx([2.0], rel=0.05)
    assert found[0, 1:][~np.array(inside)].max() < 0.4


class Simulated:
    """A rig of which the map is known: log amplitude (theta - 1)^2, first order, noisy.

    The noise is that of a power with a gamma distribution; 0.5 is of a noise-driven oscillation.
    """

    def __init__(self, tau, noise, seed=0):
        self.tau, self.noise, self.value = tau, noise, 0.0
        self.rng = np.random.default_rng(seed)

    def windows(self, theta, length):
        while True:
            aim = (theta - 1.0) ** 2
            self.value += (1.0 - math.exp(-length / self.tau)) * (aim - self.value)
            shape = 0.25 / self.noise**2
            yield np.array([self.value + 0.5 * math.log(self.rng.gamma(shape) / shape)])


def excited(rig, length=1.0, most=400):
    """Do as the excitation does; return the visits."""
    values = staircase.values(RIG.theta_min, RIG.theta_max)
    visits, queue = [], staircase.passes(True)
    while queue or (queue := staircase.next_round(visits, 0, 0, 1.0)):
        level = queue.pop(0)
        target = staircase.target_error(staircase.static_map(visits, 0))
        series, source = [], rig.windows(values[level], length)
        while True:
            series.append(next(source))
            if len(series) < staircase.FEWEST:
                continue
            judged = staircase.judge(np.array(series), [0])
            seen = [visit.settled for visit in visits]
            if not staircase.stays(judged, len(series), length, [0], target, seen,
                                   staircase.FEWEST, most):  # fmt: skip
                break
        visits.append(
            Visit(level, tuple(judged.mean), tuple(judged.error), judged.skip * length,
                  len(series) * length)
        )  # fmt: skip
    return visits


@pytest.mark.parametrize(("tau", "noise"), [(1.0, 0.02), (10.0, 0.05), (3.0, 0.5)])
def test_the_map_is_found_as_well_as_was_promised(tau, noise):
    visits = excited(Simulated(tau, noise))
    points = staircase.static_map(visits, 0)
    target = staircase.target_error(points)
    values = np.array(staircase.values(RIG.theta_min, RIG.theta_max))
    off = np.array([point.mean for point in points]) - (values - 1.0) ** 2
    assert min(point.visits for point in points) >= 2
    assert np.sqrt(np.mean(off**2)) < 1.5 * target
    assert np.abs(off).max() < 4.0 * target


def test_theta_stays_longer_where_the_rig_is_slow_or_noisy():
    usual = np.mean([visit.stay for visit in excited(Simulated(1.0, 0.02))])
    assert np.mean([visit.stay for visit in excited(Simulated(10.0, 0.02))]) > 2.0 * usual
    assert np.mean([visit.stay for visit in excited(Simulated(1.0, 0.5))]) > 2.0 * usual


def test_theta_goes_up_and_down_and_then_everywhere_at_random():
    visits = excited(Simulated(1.0, 0.02))
    levels = [visit.level for visit in visits]
    assert levels[:17] == [*range(9), *range(7, -1, -1)]
    assert sorted(levels[17:26]) == list(range(9))
    assert levels[17:26] != sorted(levels[17:26])
    assert staircase.passes(False)[:9] == list(range(8, -1, -1))


def test_limits_far_apart_are_a_geometric_series():
    found = np.array(staircase.values(0.5, 60.0))
    assert found[1:] / found[:-1] == pytest.approx(120.0 ** (1 / 8))
    assert np.diff(staircase.values(-0.5, 60.0)) == pytest.approx(60.5 / 8)


def test_a_check_moves_theta_by_a_part_of_the_range_as_it_is_looked_at():
    two = 2.0 * 120.0**0.25  # a quarter of the way from 0.5 to 60 by its logarithm
    assert staircase.away(2.0, 0.5, 60.0, 0.25) == pytest.approx(two)
    assert staircase.away(two, 0.5, 60.0, 0.25) == pytest.approx(2.0)  # that end is further off
    assert staircase.away(30.0, 0.5, 60.0, 0.25) == pytest.approx(30.0 / 120.0**0.25)
    assert staircase.away(2.0, -1.0, 3.0, 0.25) == 1.0
    assert staircase.away(0.5, 0.0, 3.0, 0.25) == 1.25


def test_of_several_features_the_one_that_shows_theta_guides():
    visits = [Visit(i, (0.0, i * 0.5, i * 0.5), (0.1, 0.1, 3.0), 0.0, 1.0) for i in range(9)]
    assert staircase.clearest(visits, range(3)) == 1


def test_progress_is_what_was_saved_and_of_this_rig(tmp_path):
    state = progress.begin(3, RIG)
    assert progress.load(RIG, tmp_path) is None
    state.how = Bands(64, (1, 2, 5), DT)
    state.visits.append(Visit(4, (0.1, -2.0), (math.inf, 0.2), 1.0, 8.0))
    progress.save(state, RIG, tmp_path)
    assert progress.load(RIG, tmp_path) == state

    with pytest.raises(ConfigError, match=r"begun with theta_max = 3.0, the rig file says 4.0"):
        progress.load(replace(RIG, theta_max=4.0), tmp_path)
    (tmp_path / progress.NAME).write_text(json.dumps({"rig": 3}))
    with pytest.raises(ConfigError, match="cannot be read"):
        progress.load(RIG, tmp_path)


@pytest.mark.parametrize("alike", [0.0, 0.9, 0.98])
def test_the_error_of_a_mean_counts_that_neighbours_are_alike(alike):
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(1500, 400))
    series = np.zeros_like(noise)
    for k in range(1, len(noise)):  # first order: the error of its mean is known
        series[k] = alike * series[k - 1] + noise[k]
    series = series[500:]
    found = np.median(staircase.standard_error(series))
    assert 0.7 * series.mean(axis=0).std() < found < 1.3 * series.mean(axis=0).std()


def test_a_level_is_that_of_the_power_whatever_the_amplitude_does_in_a_window():
    rng = np.random.default_rng(4)
    power = rng.exponential(4.0, (20_000, 1))  # of a noise-driven oscillation of rms 2
    mean, error = staircase.level(0.5 * np.log(power))
    assert mean[0] == pytest.approx(math.log(2.0), abs=4.0 * error[0])
    assert error[0] == pytest.approx(0.5 / math.sqrt(20_000), rel=0.2)


def test_more_stays_are_asked_for_where_they_decide_whether_there_is_an_optimum():
    u, error = np.linspace(0.0, 1.0, 9), np.full(9, 0.05)
    assert optimum_test.in_doubt((u - 0.5) ** 2 * 4.0, error) == []  # there is one
    assert optimum_test.in_doubt(2.0 * u, error) == []  # there is none: the end is the best by far
    assert optimum_test.in_doubt(0.0 * u, error) == []  # theta does nothing
    slight = np.where(u > 0.2, u - 0.2, 0.3 * (0.2 - u)) * 2.0
    assert optimum_test.in_doubt(slight, error) == [0, 1]
    assert optimum_test.in_doubt(slight[::-1], error) == [7, 8]
    assert optimum_test.in_doubt(slight, 0.1 * error) == []


def cliff_visits(values, edge):
    """Visits of a map that falls with log theta up to a cliff, as JSBSim's aircraft shows one."""

    def level(theta):
        return -math.log(theta) if theta < edge else 3.0

    return [
        Visit(i, (level(theta),), (0.05,), 0.0, 8.0) for i, theta in enumerate(values)
        for _ in range(3)
    ]  # fmt: skip


def test_between_the_best_value_and_a_cliff_values_are_added_until_the_cliff_is_known():
    rig = replace(RIG, theta_min=0.5, theta_max=60.0, theta_start=1.0, theta_safe=1.0)
    state, edge = progress.begin(0, rig), 12.9
    at = Scale(0.5, 60.0).u
    for _ in range(4):
        state.visits = cliff_visits(state.values, edge)
        found = staircase.between(state.visits, 0, 1.0, at(np.array(state.values)).tolist())
        for level, u in found:
            state.add(level, Scale(0.5, 60.0).theta_at(u))
    assert found == []
    assert state.values == sorted(state.values)
    below = max(v for v in state.values if v < edge)
    above = min(v for v in state.values if v > edge)
    assert at(np.array(above)) - at(np.array(below)) <= staircase.FINEST
    assert len(state.values) <= staircase.LEVELS + staircase.ADDED
    level = state.values.index(below)
    assert staircase.beside_cliff(state.visits, 0, 1.0, level, len(state.values))
    assert not staircase.beside_cliff(state.visits, 0, 1.0, level + 1, len(state.values))
    assert not staircase.beside_cliff(state.visits, 0, 1.0, 1, len(state.values))


def test_a_value_that_is_added_leaves_the_visits_where_they_were():
    state = progress.begin(0, RIG)
    state.visits = [Visit(i, (0.0,), (0.1,), 0.0, 1.0) for i in (2, 3, 4)]
    before = [state.values[visit.level] for visit in state.visits]
    state.add(3, 0.5 * (state.values[2] + state.values[3]))
    assert [state.values[visit.level] for visit in state.visits] == before


def test_a_smooth_valley_gets_no_value_beside_its_best_one():
    at = np.linspace(0.0, 1.0, 9).tolist()
    visits = [Visit(i, (3.0 * (u - 0.4) ** 2,), (0.05,), 0.0, 8.0)
              for i, u in enumerate(at) for _ in range(2)]  # fmt: skip
    assert staircase.between(visits, 0, 1.0, at) == []
