"""Limits of the controller's theta: what holds on every map, and known ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surrogate_rigs import make_map

from koop_tune.excitation.static_map import StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.limits import ThetaLimits, limit_corners, limit_theta
from koop_tune.search.settings import TUNING, TuningSettings

WIDE = RigFile(
    "/a:x", "/b:z", 0.01, 0.5, 60.0, 0.5, 1.0, 1.0
)  # fmt: skip
EVEN = replace(WIDE, theta_min=-5.0, theta_max=5.0, theta_start=2.0, theta_safe=2.0)
RANGES = [(0.5, 60.0), (-5.0, 5.0), (1000.0, 1001.0), (-1e-4, 3e-4), (0.0, 1000.0), (0.5, 1.6)]


def bowl(u, place, width, depth):
    """Return a smooth valley."""
    return depth * (1.0 - 1.0 / np.hypot(1.0, (u - place) / width))


def notch(u, place, width, depth):
    """Return a narrow valley of a depth, as a tuned absorber has, with steep sides."""
    return np.log(np.hypot(math.exp(-depth), np.minimum(np.abs(u - place) / width, 1.0))) + depth


def cliff(u, place, width, depth):
    """Return what gets better up to a cliff."""
    return np.where(u < place, width * (1.0 - u), depth)


def two(u, place, width, depth):
    """Return two valleys, of which the deeper one is narrow."""
    other = place + 0.4 if place < 0.5 else place - 0.4
    return np.minimum(notch(u, place, 0.2 * width, depth), 0.3 + bowl(u, other, width, depth))


@st.composite
def maps(draw):
    """Return the map of some holds of a random rig: some even ones, others where it is good."""
    shape = draw(st.sampled_from([bowl, notch, cliff, two]))
    place, width = draw(st.floats(0.02, 0.98)), draw(st.floats(0.01, 0.3))
    depth, noise = draw(st.floats(0.3, 4.5)), draw(st.floats(0.003, 0.3))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    mirrored = draw(st.booleans())
    near = place + rng.normal(0.0, width, draw(st.integers(0, 12)))
    u = np.clip(np.r_[np.linspace(0.0, 1.0, 5), rng.uniform(size=4), near], 0.0, 1.0)
    y = shape(1.0 - u if mirrored else u, place, width, depth) + rng.normal(0.0, noise, u.size)
    error = noise * rng.uniform(0.5, 1.5, u.size)
    sense = draw(st.sampled_from([1.0, -1.0]))
    return StaticMap(u, sense * y, error, sense)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(maps(), st.sampled_from(RANGES))
def test_the_limits_contain_the_best_with_room_on_both_sides(static_map, bounds):
    low, high = bounds
    rig = replace(
        EVEN, theta_min=low, theta_max=high, theta_start=low, theta_safe=low,
        objective="minimise" if static_map.sense > 0.0 else "maximise",
    )  # fmt: skip
    limits = limit_theta(static_map, rig)
    assert low <= limits.low < limits.high <= high
    best = static_map.best()
    u_low, u_high = (float(rig.scale.u(np.array(v))) for v in (limits.low, limits.high))
    # as is room, unless the range ends; half of it may be between the best and a cliff
    room = 0.9 * TUNING.least_room
    assert u_low <= max(best - room, 0.0)
    assert u_high >= min(best + room, 1.0)
    for limit, end, why in (
        (limits.low, low, limits.why_low), (limits.high, high, limits.why_high)
    ):  # fmt: skip
        assert (why == "") == (limit == end)
    assert limits.why.count("instead of") == (limits.low > low) + (limits.high < high)


CLOSE = np.linspace(0.35, 0.59, 5)
BEYOND = np.sort(np.r_[np.linspace(0.0, 1.0, 9), CLOSE, 0.61])


def rising(u):
    """Return what is good up to 0.6, best at 0.47, and oscillates beyond."""
    return np.where(u < 0.6, 0.5 * np.abs(u - 0.47), math.log(20.0))  # a factor of 20


@pytest.mark.parametrize("side", [1, -1])
def test_theta_is_kept_away_from_a_cliff_but_not_from_the_best(side):
    u = BEYOND if side > 0 else 1.0 - BEYOND
    actual = make_map(lambda v: rising(v if side > 0 else 1.0 - v), 0.01, u=u)
    assert actual.cliff(side) is not None

    def inside(margin):
        limits = limit_theta(actual, EVEN, TuningSettings(margin=margin))
        limit, why = (limits.high, limits.why_high) if side > 0 else (limits.low, limits.why_low)
        assert "all at once" in why
        assert ("theta_max" if side > 0 else "theta_min") in why
        u = float(EVEN.scale.u(np.array(limit)))
        return u if side > 0 else 1.0 - u

    assert inside(0.03) == pytest.approx(0.59 - 0.03, abs=1e-3)
    best = actual.best() if side > 0 else 1.0 - actual.best()
    # never nearer to the best than half way to the cliff
    assert inside(0.5) == pytest.approx(best + 0.5 * (0.61 - best), abs=1e-3)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_theta_is_kept_in_the_valley(sense):
    u = np.linspace(0.0, 1.0, 31)

    def limits(slope, rig=EVEN):
        level = make_map(lambda v: sense * slope * np.abs(v - 0.4), 0.01, sense, u)
        rig = replace(rig, objective="minimise" if sense > 0.0 else "maximise")
        return limit_theta(level, rig)

    actual = limits(5.0)
    for limit, side in ((actual.low, -1), (actual.high, 1)):
        expected = 0.4 + side * math.log(TUNING.limits) / 5.0  # that many times the best
        assert float(EVEN.scale.u(np.array(limit))) == pytest.approx(expected, abs=0.01)
    assert "instead of 5" in actual.why_high
    bad = f"{TUNING.limits:g} times" if sense > 0.0 else f"1/{TUNING.limits:g} of"
    assert f"the oscillation is {bad} the best or worse" in actual.why_low
    assert limits(0.4) == (-5.0, 5.0, "", "", ())  # good everywhere
    far = limits(5.0, WIDE)  # positions are those of log theta
    assert float(WIDE.scale.u(np.array(far.high))) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("side", [1, -1])
def test_an_optimum_that_moves_has_room_ahead(side):
    actual = make_map(lambda v: 5.0 * np.abs(v - 0.5), 0.01, u=np.linspace(0.0, 1.0, 31))
    still, moving = limit_theta(actual, EVEN), limit_theta(actual, EVEN, motion=0.2 * side)
    behind, ahead = (0, 1) if side > 0 else (1, 0)
    assert moving[behind] == still[behind]
    assert moving[ahead] == pytest.approx(still[ahead] + 2.0 * side, abs=1e-3)


TWO = replace(
    WIDE, command="/b:z[0],z[1]", theta_min=(-1.0, 0.1), theta_max=(3.0, 10.0), theta_rate=0.5,
    theta_start=(2.0, 5.0), theta_safe=(2.0, 5.0),
)  # fmt: skip


def limit_two(level):
    """Return limits at u 0.3 and 0.7 of two knobs, and what holds of a map make of them."""
    u = np.random.default_rng(0).uniform(0.2, 0.8, (60, 2))
    y = level(u) + np.random.default_rng(1).normal(0.0, 0.05, 60)
    ends = [TWO.theta_at((end, end)) for end in (0.3, 0.7)]
    limits = [ThetaLimits(low, high, "a", "b") for low, high in zip(*ends, strict=True)]
    holds = (u, y, np.full(60, 0.05))
    return limits, limit_corners(TWO, limits, np.array([0.5, 0.5]), [0, 1], holds)


def test_limits_of_two_knobs_come_nearer_where_their_corners_are_far_worse():
    """A ravine: good along one diagonal, 20 times the best off it."""

    def level(u):
        return math.log(20.0) * np.minimum(np.abs(u[:, 0] - u[:, 1]) / 0.3, 1.0)

    limits, nearer = limit_two(level)
    new = TWO.u(np.transpose([limit[:2] for limit in nearer]))
    ways = np.abs(new - 0.5)
    assert ways == pytest.approx(ways[0, 0], abs=1e-3)  # all by the same share
    corner = np.array([[new[0, 0], new[1, 1]]])
    assert 0.05 < ways[0, 0] < 0.2
    assert math.exp(level(corner)[0]) == pytest.approx(3.0, rel=0.5)
    assert math.exp(level(np.array([[0.3, 0.7]]))[0]) > 15.0
    for old, limit, name in zip(limits, nearer, TWO.knob_names, strict=True):
        assert f"theta_min {limit.low:.10g} instead of" in limit.why_low, name
        assert f"such as {old.high:.4g}" in limit.why_high
        assert "times the best" in limit.why


def test_limits_of_two_knobs_stay_where_their_corners_are_little_worse():
    limits, same = limit_two(lambda u: 4.0 * ((u - 0.5) ** 2).sum(axis=1))
    assert same == limits
