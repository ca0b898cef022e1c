"""Limits of the controller's theta, on maps of which the good part is known."""

from dataclasses import replace

import numpy as np
import pytest

from koop_tune.excitation.static_map import StaticMap
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.search.limits import limit_theta
from koop_tune.search.settings import TuningSettings

WIDE = RigFile(
    "/a:x", "a/msg/A", "/b:z", "std_msgs/msg/Float64", 0.01, 0.5, 60.0, 0.5, 1.0, 1.0
)  # fmt: skip
EVEN = replace(WIDE, theta_min=-5.0, theta_max=5.0, theta_start=2.0, theta_safe=2.0)
VALUES = [0.5, 0.91, 1.66, 3.01, 5.48, 9.97, 11.6, 13.4, 18.1, 33.0, 60.0]


def cliff_map(values, edge, calm_once=False):
    """The map of a rig that gets better up to an edge and oscillates beyond it."""
    u = Scale(0.5, 60.0).u(np.array(values))
    visits = [np.full(2, -2.0 * own if theta < edge else 4.0)
              for own, theta in zip(u, values, strict=True)]  # fmt: skip
    if calm_once:  # the first value beyond, when it was come to from below
        i = int(np.argmax(np.array(values) >= edge))
        visits[i] = np.array([-2.0 * u[i], 4.0])
    mean = np.array([own.mean() for own in visits])
    return StaticMap(u, mean, np.full(u.size, 0.05), 1.0, visits)


@pytest.mark.parametrize("calm_once", [False, True])
def test_theta_is_kept_away_from_a_cliff_that_is_known(calm_once):
    found = cliff_map(VALUES, 13.0, calm_once)
    limits = limit_theta(found, found, WIDE)
    assert "all at once" in limits.why_high
    assert "theta_max" in limits.why_high
    inner = WIDE.scale.u(np.array(11.6))
    assert WIDE.scale.u(np.array(limits.high)) == pytest.approx(inner - 0.06, abs=0.005)
    narrow = limit_theta(found, found, WIDE, TuningSettings(margin=0.2))
    assert WIDE.scale.u(np.array(narrow.high)) == pytest.approx(inner - 0.2, abs=0.005)


def test_a_cliff_that_is_not_there_or_not_known_keeps_theta_from_nothing():
    none = cliff_map(VALUES, 70.0)
    assert "all at once" not in limit_theta(none, none, WIDE).why
    coarse = cliff_map([v for v in VALUES if v not in (11.6, 13.4)], 13.0)
    limits = limit_theta(coarse, coarse, WIDE)  # the optimum may be anywhere before it
    assert "all at once" not in limits.why
    assert limits.high > 13.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_theta_is_kept_where_the_map_is_good_and_has_room_there(sense):
    u = np.linspace(0.0, 1.0, 21)

    def limits(slope, error):
        mean = sense * slope * np.abs(u - 0.4)
        found = StaticMap(u, mean, np.full(u.size, error), sense, [np.full(2, y) for y in mean])
        return limit_theta(found, found, EVEN)

    found = limits(5.0, 0.01)  # 1.5 times the best at 0.4 +- log(1.5) / 5, and a little for errors
    for limit, side in ((found.low, -1), (found.high, 1)):
        assert EVEN.scale.u(np.array(limit)) == pytest.approx(0.4 + side * (0.081 + 0.1), abs=0.02)
    assert "instead of 5" in found.why
    unsure = limits(5.0, 0.2)  # what may be good is not left out
    assert unsure.low < found.low
    assert unsure.high > found.high
    assert limits(0.5, 0.01) == (-5.0, 5.0, "", "")  # good everywhere
