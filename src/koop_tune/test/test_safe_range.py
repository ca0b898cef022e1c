"""The search for the thetas that keep a bound: it stays inside, and comes near the bound."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koop_tune.excitation.safe_range import SAFE_RANGE, SafeRange, SafeRangeSearch, forecast
from koop_tune.rig.rig_file import RigFile

LINEAR = RigFile(
    measured="/rig:x", command="/rig/theta:data", dt=0.01, theta_min=-1.0, theta_max=3.0,
    theta_rate=1.0, theta_safe=1.0, theta_start=1.0,
)  # fmt: skip
WIDE = replace(LINEAR, theta_min=0.05, theta_max=20.0)


def find(rig, margin):
    """Return the range, and every theta that was held."""
    search, held = SafeRangeSearch(rig), []
    while (theta := search.next()) is not None:
        held.append(theta)
        assert len(held) < 200
        search.take(theta, margin(theta))
    return search.result(), held


ROUNDS = replace(LINEAR, theta_min=-0.1, theta_max=0.3, theta_start=0.0, theta_safe=0.0)
AGAIN = replace(LINEAR, theta_min=0.3, theta_max=1.6, theta_start=1.17, theta_safe=1.17)


@pytest.mark.parametrize("rig", [LINEAR, WIDE, ROUNDS, AGAIN])
def test_without_a_bound_in_reach_it_is_the_range_of_the_rig_file(rig):
    safe, held = find(rig, lambda theta: 0.8)
    # failed before: rounding led beyond theta_max, to a bound just below it, or past theta_safe
    assert (safe.low, safe.high) == (rig.theta_min, rig.theta_max)
    assert (safe.bound_low, safe.bound_high) == (False, False)
    assert safe.slope(rig.scale) == 0.0
    assert len(held) < 30
    span = rig.theta_max - rig.theta_min  # up, down and back
    seconds = len(held) * SAFE_RANGE.windows * 0.5 + 2.0 * span / rig.theta_rate
    assert forecast(rig, 0.5) == (len(held), pytest.approx(seconds))
    assert safe.narrow(rig).theta_max == pytest.approx(rig.theta_max)


@settings(deadline=None)
@given(bound=st.floats(0.15, 0.9), sharp=st.floats(0.5, 4.0), side=st.sampled_from([-1, 1]))
def test_a_bound_is_approached_from_inside(bound, sharp, side):
    """A statistic that grows exponentially towards the bound, as an effort does."""
    at = 1.0 + 2.0 * side * bound

    def margin(theta):
        return 1.0 - math.exp(sharp * side * (theta - at))

    safe, held = find(LINEAR, margin)
    assert min(margin(theta) for theta in held) >= 0.0
    end = safe.high if side > 0 else safe.low
    assert 0.0 <= margin(end) < 2.0 * SAFE_RANGE.enough + sharp * 0.04
    assert (safe.bound_low, safe.bound_high) == (side < 0, side > 0)
    slope = safe.slope(LINEAR.scale)
    assert side * slope < 0.0
    assert abs(slope) <= sharp  # nowhere is it steeper inside the bound
    assert safe.low <= held[int(np.argmax([margin(t) for t in held]))] <= safe.high


@pytest.mark.parametrize("edge", [1.07, 1.5, 2.9])
def test_what_breaks_all_at_once_is_broken_seldom(edge):
    safe, held = find(LINEAR, lambda theta: 0.5 if theta < edge else -0.5)
    assert edge - 0.1 < safe.high < edge
    assert sum(theta >= edge for theta in held) <= 6
    assert safe.low == LINEAR.theta_min


@pytest.mark.parametrize(("rig", "theta"), [(LINEAR, (1.0, 1.5, 2.0, 2.1)), (WIDE, (1, 2, 4, 5))])
def test_a_bound_that_was_broken_leaves_the_slope_there_in_the_limits_that_keep_it(rig, theta):
    """Failed before: -5e11, the value that broke the bound was taken for the limit."""
    safe = SafeRange(theta, (0.5, 0.4, 0.1, -0.05), rig.theta_min, theta[2], False, True)
    scale = safe.narrow(rig).scale
    u = np.log(theta) if scale.logarithmic else theta
    assert scale.logarithmic == (rig is WIDE)
    assert safe.slope(scale) == pytest.approx(min(np.diff(safe.margin) / np.diff(u)))


def test_bounds_on_both_sides_leave_no_slope_to_go_by():
    safe, _ = find(LINEAR, lambda theta: 1.0 - (theta - 1.0) ** 2)
    assert (safe.bound_low, safe.bound_high) == (True, True)
    assert safe.slope(LINEAR.scale) == 0.0
    assert 0.0 < safe.low < 0.1
    assert 1.9 < safe.high < 2.0
    assert min(safe.margin) >= 0.0


def test_a_bound_that_theta_safe_breaks_leaves_nothing():
    search = SafeRangeSearch(LINEAR)
    search.take(search.next(), -0.1)
    assert search.next() is None
