"""Who answered what, and how old it was: told from the columns of a recording."""

import numpy as np
import pytest

from koop_hil.answers import active_times, ages, answered_twice, authors

TICK = 5_000_000  # [ns]


def columns(**values):
    return {name.replace("__", "."): np.array(column) for name, column in values.items()}


def loop(steps=200, delay=1):
    """Return what a loop without faults records: answers act ``delay`` ticks later."""
    k = np.arange(steps)
    theta = 2.0 - 0.001 * k
    applied = np.concatenate([np.full(delay, 2.0), theta[:-delay]])
    return (
        columns(step=k, publish_time=k * TICK),
        columns(step=k, publish_time=k * TICK + 1_000_000, theta=theta),
        columns(step=k, publish_time=k * TICK, theta_applied=applied),
    )


def test_in_a_loop_without_faults_an_answer_is_as_old_as_the_loop_takes():
    found = ages(*loop(delay=3))
    assert found.acted == pytest.approx(0.015)
    assert found.sent == pytest.approx(0.001)
    assert found.unexplained == 0


def test_an_answer_that_comes_late_is_old_when_it_acts_though_it_was_sent_in_time():
    state, theta, ground_truth = loop()
    ground_truth["theta_applied"][50:90] = ground_truth["theta_applied"][49]  # a cut link
    assert ages(state, theta, ground_truth).acted == pytest.approx(0.005)
    for i in range(90, 120):  # what was kept comes in a burst, eight a tick
        ground_truth["theta_applied"][i] = theta["theta"][min(50 + 8 * (i - 90), i - 1)]
    found = ages(state, theta, ground_truth)
    assert found.acted == pytest.approx(40 * 0.005)  # step 50 acts at step 90
    assert found.sent == pytest.approx(0.001)


def test_the_answer_to_an_old_state_is_old_when_it_is_sent():
    state, theta, ground_truth = loop()
    theta["publish_time"][50:90] = 90 * TICK + np.arange(40)
    assert ages(state, theta, ground_truth).sent == pytest.approx(40 * 0.005, abs=1e-4)


def test_a_held_theta_may_be_sent_at_any_age():
    state, theta, ground_truth = loop()
    theta["publish_time"][50:90] = 90 * TICK + np.arange(40)
    theta["theta"][50:90] = theta["theta"][49]
    ground_truth["theta_applied"][51:91] = theta["theta"][49]
    found = ages(state, theta, ground_truth)
    assert found.sent == pytest.approx(0.001)
    assert found.acted == pytest.approx(0.005)


def test_a_move_while_nothing_was_recorded_happened_at_no_known_time():
    state, theta, ground_truth = loop()
    kept = (theta["step"] < 50) | (theta["step"] > 150)
    seen = {name: values[kept] for name, values in ground_truth.items()}
    seen["theta_applied"][seen["step"] == 151] = theta["theta"][49]  # moved to it during the cut
    found = ages(state, theta, seen)
    assert found.acted == pytest.approx(0.005)
    assert found.unexplained == 0


def test_a_theta_that_nobody_sent_is_noticed():
    state, theta, ground_truth = loop()
    ground_truth["theta_applied"][100] = 7.0
    assert ages(state, theta, ground_truth).unexplained == 1


def test_two_controllers_answer_twice_and_one_that_is_asked_again_does_not():
    cost = columns(step=[0, 1, 1, 2, 3])
    assert answered_twice(cost, columns(step=[0, 1, 1, 2, 3])) == 0
    assert answered_twice(cost, columns(step=[0, 1, 2])) == 0
    assert answered_twice(cost, columns(step=[0, 1, 1, 1, 2, 2, 3])) == 2


def transitions(*events):
    times, starts, goals = zip(*events, strict=True)
    return columns(
        publish_time=times, start_state__label=list(starts), goal_state__label=list(goals)
    )


def test_an_answer_is_of_the_controller_that_was_active():
    first = transitions(
        (300, "active", "deactivating"),
        (310, "deactivating", "inactive"),
        (700, "inactive", "activating"),
        (710, "activating", "active"),
    )
    second = transitions(
        (100, "unconfigured", "configuring"), (350, "activating", "active"), (650, "active", "x")
    )
    active = {"first": active_times(first), "second": active_times(second)}
    assert active == {
        "first": [(0, 300), (710, np.iinfo(np.int64).max)],
        "second": [(350, 650)],
    }
    theta = columns(publish_time=[10, 290, 360, 400, 640, 720, 9000])
    assert authors(theta, active) == ({"first": 4, "second": 3}, 0)
    theta = columns(publish_time=[320, 360, 680])
    assert authors(theta, active) == ({"first": 0, "second": 1}, 2)
    both = {"first": [(0, 500)], "second": [(400, 900)]}
    assert authors(columns(publish_time=[100, 450, 600]), both) == ({"first": 1, "second": 1}, 1)


def test_a_controller_without_transitions_in_the_recording_was_active_all_the_time():
    nothing = columns(publish_time=[], start_state__label=[], goal_state__label=[])
    assert active_times(nothing) == [(0, np.iinfo(np.int64).max)]


def test_a_move_in_a_gap_of_the_recording_counts_as_early_as_it_can_have_been():
    state, theta, ground_truth = loop()
    kept = np.r_[0:50, 90:200]
    gap = {name: column[kept] for name, column in ground_truth.items()}
    gap["theta_applied"][50] = theta["theta"][48]  # the answer that was the next to act
    found = ages(state, theta, gap)
    assert found.acted == pytest.approx(0.005)
    gap["theta_applied"][50] = theta["theta"][30]
    assert ages(state, theta, gap).acted == pytest.approx(0.095)
