"""Answers and their ages, from the columns of a recording."""

import numpy as np
import pytest

from koop_hil.answers import age_acting

TICK = 5_000_000  # [ns]


def columns(**values):
    return {name.replace("__", "."): np.array(column) for name, column in values.items()}


def loop(steps=200, delay=1):
    """Return what a loop without faults records: answers act ``delay`` ticks later."""
    k = np.arange(steps)
    answered = np.maximum(k - delay, -1)
    return (
        columns(step=k, publish_time=k * TICK),
        columns(step=k, publish_time=k * TICK, theta_step=answered),
    )


def test_in_a_loop_without_faults_an_answer_is_as_old_as_the_loop_takes():
    state, ground_truth = loop(delay=3)
    assert age_acting(state, ground_truth) == pytest.approx(0.015)


def test_a_held_answer_grows_no_older_and_one_that_begins_to_act_late_is_old():
    state, ground_truth = loop()
    ground_truth["theta_step"][50:90] = 48  # a cut link
    ground_truth["theta_step"][90:] = np.arange(89, 199)
    assert age_acting(state, ground_truth) == pytest.approx(0.005)
    ground_truth["theta_step"][90] = 50  # what was kept
    assert age_acting(state, ground_truth) == pytest.approx(40 * 0.005)


def test_an_answer_that_began_to_act_in_a_gap_of_the_recording_did_so_as_early_as_it_can_have():
    state, ground_truth = loop()
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
    state, ground_truth = (
        {name: np.concatenate([a[name], b[name]]) for name in a}
        for a, b in zip(first, second, strict=True)
    )
    assert age_acting(state, ground_truth) == pytest.approx(0.005)


def test_an_answer_to_a_state_that_was_not_recorded_has_no_age():
    state, ground_truth = loop()
    ground_truth["theta_step"][100] = 10**6
    state = {name: column[:80] for name, column in state.items()}
    assert age_acting(state, ground_truth) == pytest.approx(0.005)
