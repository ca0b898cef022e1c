"""Costs without a recorded theta: not heard by the controller, or not by the recorder."""

import numpy as np
import pytest

from koop_lab.replay.unheard import unheard_costs

STEP = 0.01


def recorded(theta, lost):
    has_theta = np.ones(theta.size, bool)
    has_theta[lost] = False
    return np.ones(theta.size, bool), has_theta, np.where(has_theta, theta, np.nan), STEP


def test_a_controller_that_stood_still_meanwhile_did_not_hear():
    theta = 2.0 - STEP * np.concatenate([np.arange(50), np.full(20, 49), np.arange(50, 80)])
    found = unheard_costs(*recorded(theta, slice(50, 70)))
    assert np.flatnonzero(found).tolist() == list(range(50, 70))


def test_a_controller_that_moved_on_did_hear():
    assert not unheard_costs(*recorded(2.0 - STEP * np.arange(100), slice(50, 70))).any()


@pytest.mark.parametrize("lost", [slice(0, 10), slice(90, 100), slice(0, 100), slice(0, 0)])
def test_before_the_first_theta_and_after_the_last_nothing_is_known(lost):
    assert not unheard_costs(*recorded(np.full(100, 2.0), lost)).any()


def test_a_state_without_a_cost_is_not_a_cost_that_was_not_heard():
    has_r, has_theta, theta, step = recorded(np.full(100, 2.0), slice(50, 60))
    has_r[55] = False
    assert np.flatnonzero(unheard_costs(has_r, has_theta, theta, step)).tolist() == [
        50, 51, 52, 53, 54, 56, 57, 58, 59
    ]  # fmt: skip
