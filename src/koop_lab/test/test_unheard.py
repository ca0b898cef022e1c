"""Costs without a recorded theta: not heard by the controller, or not by the recorder."""

import numpy as np
import pytest

from koop_lab.replay.unheard import find_join, unheard_costs

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


def late(held):
    """Return answers of which the first 30 thetas are missing and the next ones are held."""
    theta = 2.0 - STEP * np.maximum(np.arange(100) - 30 - held, 0)
    has_r, has_theta, theta, _ = recorded(theta, slice(0, 30))
    holding = np.arange(100) < 30 + held
    return has_r, has_theta, holding, theta


def test_a_controller_that_holds_its_first_thetas_for_as_long_as_one_that_joins_has_joined():
    assert find_join(*late(held=20), settling=20) == 30


def test_a_controller_whose_first_thetas_move_sooner_was_there_before():
    assert find_join(*late(held=0), settling=20) is None
    assert find_join(*late(held=10), settling=20) is None


def test_where_theta_begins_with_the_costs_nobody_joined_late():
    has_r, has_theta, holding, theta = late(held=20)
    has_r[:30] = False  # of a lifter that joined, too
    assert find_join(has_r, has_theta, holding, theta, settling=20) is None
