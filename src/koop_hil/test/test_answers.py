"""Answers and their ages, from the columns of a recording."""

import numpy as np
import pytest

from koop_hil.answers import age_acting, age_sent, answered_twice

TICK = 5_000_000  # [ns]


def columns(**values):
    return {name.replace("__", "."): np.array(column) for name, column in values.items()}


def loop(steps=200, delay=1):
    """Return what a loop without faults records: answers act ``delay`` ticks later."""
    k = np.arange(steps)
    answered = np.maximum(k - delay, -1)
    return (
        columns(step=k, publish_time=k * TICK),
        columns(step=k, publish_time=k * TICK + 1_000_000, theta=2.0 - 0.001 * k),
        columns(step=k, publish_time=k * TICK, theta_step=answered),
    )


def test_in_a_loop_without_faults_an_answer_is_as_old_as_the_loop_takes():
    state, theta, ground_truth = loop(delay=3)
    assert age_acting(state, ground_truth) == pytest.approx(0.015)
    assert age_sent(state, theta) == pytest.approx(0.001)


def test_a_held_answer_grows_no_older_and_one_that_begins_to_act_late_is_old():
    state, theta, ground_truth = loop()
    ground_truth["theta_step"][50:90] = 48  # a cut link
    ground_truth["theta_step"][90:] = np.arange(89, 199)
    assert age_acting(state, ground_truth) == pytest.approx(0.005)
    ground_truth["theta_step"][90] = 50  # what was kept
    assert age_acting(state, ground_truth) == pytest.approx(40 * 0.005)
    assert age_sent(state, theta) == pytest.approx(0.001)


def test_an_answer_that_began_to_act_in_a_gap_of_the_recording_did_so_as_early_as_it_can_have():
    state, _, ground_truth = loop()
    ground_truth["theta_step"][40:91] = 39
    ground_truth["theta_step"][90] = 49
    kept = np.r_[0:51, 90:200]
    gap = {name: column[kept] for name, column in ground_truth.items()}
    assert age_acting(state, gap) == pytest.approx(0.005)
    gap["theta_step"][51] = 20
    assert age_acting(state, gap) == pytest.approx(30 * 0.005)


def test_a_plant_that_is_started_again_counts_its_own_steps():
    first, second = loop(), loop()
    for column in second:
        column["publish_time"] += 1000 * TICK
    state, theta, ground_truth = (
        {name: np.concatenate([a[name], b[name]]) for name in a}
        for a, b in zip(first, second, strict=True)
    )
    assert age_acting(state, ground_truth) == pytest.approx(0.005)
    assert age_sent(state, theta) == pytest.approx(0.001)


def test_the_answer_to_an_old_state_is_old_when_it_is_sent_unless_theta_is_held():
    state, theta, _ = loop()
    theta["publish_time"][50:90] = 90 * TICK + np.arange(40)
    assert age_sent(state, theta) == pytest.approx(40 * 0.005, abs=1e-4)
    theta["theta"][50:90] = theta["theta"][49]
    assert age_sent(state, theta) == pytest.approx(0.001)


def test_an_answer_to_a_state_that_was_not_recorded_has_no_age():
    state, _, ground_truth = loop()
    ground_truth["theta_step"][100] = 10**6
    state = {name: column[:80] for name, column in state.items()}
    assert age_acting(state, ground_truth) == pytest.approx(0.005)


def test_two_controllers_answer_twice_and_one_that_is_asked_again_does_not():
    cost = columns(step=[0, 1, 1, 2, 3])
    assert answered_twice(cost, columns(step=[0, 1, 1, 2, 3])) == 0
    assert answered_twice(cost, columns(step=[0, 1, 2])) == 0
    assert answered_twice(cost, columns(step=[0, 1, 1, 1, 2, 2, 3])) == 2
