"""An excitation's decisions, on simulated rigs of which settling time, noise and map are known."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from koop_core.config.parameter import ConfigError
from koop_core.errors import InputError
from koop_tune.excitation import progress
from koop_tune.excitation.features import Bands
from koop_tune.excitation.survey import SURVEY, Survey, SurveySettings, beside_cliff
from koop_tune.excitation.visits import Visit
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale

DT, PERIOD = 0.01, 0.5
RIG = RigFile(
    "/a:x", "a/msg/A", "/b:z", "std_msgs/msg/Float64", DT, -1.0, 3.0, 0.5, 2.0, 0.5, time=1e5
)  # fmt: skip


def valley(theta):
    """Return the logarithm of the amplitude at which the rig settles."""
    return (theta - 1.0) ** 2


class Simulated:
    """An oscillation whose log amplitude follows its map, first order, and is noisy.

    The noise is that of a power with a gamma distribution; 0.5 is of a noise-driven oscillation.
    """

    def __init__(self, tau, noise, level=valley):
        self.tau, self.noise, self.level = tau, noise, level
        self.value, self.seconds, self.rng = level(RIG.theta_start), 0.0, np.random.default_rng(0)

    def window(self, theta, samples):
        self.seconds += samples * DT
        self.value += (1.0 - math.exp(-samples * DT / self.tau)) * (self.level(theta) - self.value)
        shape = 0.25 / self.noise**2
        amplitude = math.exp(self.value) * math.sqrt(self.rng.gamma(shape) / shape)
        t = self.seconds + np.arange(samples) * DT
        return amplitude * np.sin(2.0 * np.pi * t / PERIOD)[:, None]


def excite(simulated, rig=RIG, settings=SURVEY):
    """Excite a rig as `koop excite` does; return what was done."""
    state = progress.begin(0, rig)
    survey = Survey(rig, state, settings)
    x = simulated.window(rig.theta_start, round(settings.shortest / DT))
    while survey.listens(x):
        x = np.concatenate([x, simulated.window(rig.theta_start, 100)])
    periods = survey.look(x)
    assert periods.strongest == pytest.approx(PERIOD, rel=0.02)
    while (theta := survey.next_value()) is not None and simulated.seconds < rig.time:
        survey.arrive(simulated.seconds)
        while not survey.take(simulated.window(theta, state.bands.length)):
            pass
    return state


@pytest.mark.parametrize(("tau", "noise"), [(1.0, 0.02), (10.0, 0.05), (3.0, 0.5)])
def test_the_map_is_found_as_well_as_was_promised(tau, noise):
    state = excite(Simulated(tau, noise))
    assert state.done
    found = state.static_map(0, RIG.sense)
    off = found.mean - valley(np.array(state.values))
    target = max(SURVEY.error, SURVEY.error_of_span * float(np.ptp(found.mean)))
    assert min(levels.size for levels in found.visits) >= 2
    assert np.std(off) < 1.5 * target
    assert np.abs(off - off.mean()).max() < 4.0 * target


def test_theta_does_not_go_on_before_a_slow_rig_has_settled():
    def shallow(theta):  # neighbours differ by so little that a drift looks like a small error
        return 0.3 * valley(theta)

    state = excite(Simulated(40.0, 0.001, shallow))
    off = state.static_map(0).mean - shallow(np.array(state.values))
    assert np.abs(off - off.mean()).max() < 0.05


def test_theta_rests_longer_where_the_rig_is_slow_or_noisy():
    def rest(tau, noise):
        return np.mean([visit.stay for visit in excite(Simulated(tau, noise)).visits])

    usual = rest(1.0, 0.02)
    assert rest(20.0, 0.02) > 2.0 * usual
    assert rest(1.0, 0.5) > 2.0 * usual


def test_a_rest_is_as_long_as_the_settings_and_the_time_allow():
    short = excite(Simulated(1.0, 0.02), settings=SurveySettings(fewest=12))
    window = short.bands.length * DT
    assert min(visit.stay for visit in short.visits) >= 12 * window - 1e-9
    hurried = excite(Simulated(50.0, 0.5), replace(RIG, time=1500.0))
    assert max(v.stay for v in hurried.visits) <= SURVEY.most_share * 1500.0
    assert not hurried.done


def test_theta_goes_up_and_down_and_then_everywhere_at_random():
    state = excite(Simulated(1.0, 0.02))
    levels = [visit.level for visit in state.visits]
    down_first = [*range(8, -1, -1), *range(1, 9)]  # theta starts in the upper half
    assert levels[:17] == down_first
    assert sorted(levels[17:26]) == list(range(9))
    assert levels[17:26] != sorted(levels[17:26])
    assert all(a != b for a, b in pairwise(levels))  # a visit is an arrival
    assert progress.begin(0, replace(RIG, theta_start=0.0)).queue[:9] == list(range(9))


def test_values_are_added_until_a_cliff_is_known_and_theta_lingers_there():
    rig = replace(RIG, theta_min=0.5, theta_max=60.0, theta_start=1.0, theta_safe=1.0)
    edge = 12.9

    def cliff(theta):  # as JSBSim's aircraft has one
        return -math.log(theta) if theta < edge else 3.0

    state = excite(Simulated(1.0, 0.05, cliff), rig)
    u = Scale(0.5, 60.0).u(np.array(state.values))
    below = max(i for i, v in enumerate(state.values) if v < edge)
    assert state.values == sorted(state.values)
    assert 0 < state.added_values <= SURVEY.added
    assert u[below + 1] - u[below] <= SURVEY.finest + 0.125 / 2**SURVEY.added
    window = state.bands.length * DT
    lingers = [v.stay for v in state.visits if v.level == below][-1]
    assert lingers >= SURVEY.linger * window - 1e-9
    found = state.static_map(0)
    assert [beside_cliff(found, state.reached, i) for i in (below - 1, below, below + 1)] == [
        False, True, False
    ]  # fmt: skip
    assert beside_cliff(found, [*range(below + 1), *range(below + 2, len(u) + 1)], below + 1)


def test_a_smooth_valley_gets_no_value_beside_its_best_one():
    state = excite(Simulated(1.0, 0.02, lambda theta: 3.0 * (theta - 0.4) ** 2))
    assert state.added_values == 0
    assert len(state.values) == progress.LEVELS


def test_channels_that_do_not_move_are_refused():
    survey = Survey(RIG, progress.begin(0, RIG))
    with pytest.raises(InputError, match="no channel moves"):
        survey.look(np.ones((1000, 1)))


def test_the_feature_that_shows_theta_guides():
    state = progress.begin(0, RIG)
    state.visits = [
        Visit(i, (0.0, i * 0.5, i * 0.5), (0.1, 0.1, 3.0), 0.0, 1.0) for i in (*range(9), 8)
    ]
    assert state.clearest(range(3)) == 1
    assert state.static_map(1).visits[8].tolist() == [4.0, 4.0]


def test_a_value_that_is_added_leaves_the_visits_where_they_were():
    state = progress.begin(0, RIG)
    state.visits = [Visit(i, (0.0,), (0.1,), 0.0, 1.0) for i in (2, 3, 4)]
    before = [state.values[visit.level] for visit in state.visits]
    state.add(3, 0.5 * (state.values[2] + state.values[3]))
    assert [state.values[visit.level] for visit in state.visits] == before
    assert (state.levels, state.staircase, state.reached) == (9, 17, [2, 4, 5])


def test_every_value_but_the_turning_point_is_visited_twice():
    def lacks(*levels):
        state = progress.begin(0, RIG)
        state.values = state.values[:3]
        state.visits = [Visit(level, (0.0,), (0.1,), 0.0, 1.0) for level in levels]
        return state.lacks_visits

    assert not lacks(0, 1, 2, 1, 0)
    assert lacks(0, 1, 2, 1)
    assert lacks(0, 1, 0, 1)


def test_progress_is_what_was_saved_and_of_this_rig(tmp_path):
    state = progress.begin(3, RIG)
    assert progress.load(RIG, tmp_path) is None
    state.bands = Bands(64, (1, 2, 5), DT)
    state.visits.append(Visit(4, (0.1, -2.0), (math.inf, 0.2), 1.0, 8.0))
    progress.save(state, RIG, tmp_path)
    assert progress.load(RIG, tmp_path) == state

    with pytest.raises(ConfigError, match=r"begun with theta_max = 3.0, the rig file says 4.0"):
        progress.load(replace(RIG, theta_max=4.0), tmp_path)
    (tmp_path / progress.NAME).write_text(json.dumps({"rig": 3}))
    with pytest.raises(ConfigError, match="cannot be read"):
        progress.load(RIG, tmp_path)
