"""Positions in theta's range, and the values of an excitation."""

import numpy as np
import pytest

from koop_tune.rig.scale import Scale


@pytest.mark.parametrize("scale", [Scale(-1.0, 3.0), Scale(0.5, 60.0), Scale(1.0, 2.0)])
def test_a_position_and_its_theta_are_each_others_inverse(scale):
    u = np.linspace(0.0, 1.0, 33)
    assert scale.u(scale.theta(u)) == pytest.approx(u, abs=1e-12)
    assert (scale.theta_at(0.0), scale.theta_at(1.0)) == pytest.approx((scale.low, scale.high))
    assert scale.u(np.array([scale.low - 1.0, scale.high + 1.0])).tolist() == [0.0, 1.0]


def test_limits_far_apart_are_divided_by_a_factor_others_evenly():
    u = np.linspace(0.0, 1.0, 9)
    values = Scale(0.5, 60.0).theta(u)
    assert values[1:] / values[:-1] == pytest.approx(120.0 ** (1 / 8))
    assert np.diff(Scale(-0.5, 60.0).theta(u)) == pytest.approx(60.5 / 8)


def test_a_step_goes_towards_the_limit_further_off():
    far = Scale(0.5, 60.0)
    assert (far.logarithmic, Scale(0.5, 60.0, apart=200.0).logarithmic) == (True, False)
    two = 2.0 * 120.0**0.25  # a quarter of the way from 0.5 to 60 by its logarithm
    assert far.step_away(2.0, 0.25) == pytest.approx(two)
    assert far.step_away(two, 0.25) == pytest.approx(2.0)
    assert far.step_away(30.0, 0.25) == pytest.approx(30.0 / 120.0**0.25)
    assert Scale(-1.0, 3.0).step_away(2.0, 0.25) == 1.0
    assert Scale(0.0, 3.0).step_away(0.5, 0.25) == 1.25
