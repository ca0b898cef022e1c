"""Late ticks, and the age of the state that a theta answers."""

import math

import numpy as np
import pytest

from vdp_plant.config import PaceConfig
from vdp_plant.pacing import KEPT, age, tick


def test_a_tick_that_took_the_place_of_others_counts_them():
    due, told = 10.005, []
    for now in (10.005, 10.011, 10.0149, 10.0375, 10.04):
        late, due = tick(due, 0.005, now)
        told.append(late)
    # 1 ms late is not a period late; due at 10.02, three periods are gone
    assert told == [0, 0, 0, 3, 0]


def sent_at(times):
    sent = np.full(KEPT, np.nan)
    for k, now in enumerate(times):
        sent[k % KEPT] = now
    return sent


def test_the_age_of_an_answer_is_that_of_its_state():
    assert math.isnan(age(sent_at([]), -1, 0.005, 0, 1.0))
    sent = sent_at(10.0 + 0.02 * np.arange(100))  # late ticks: slower than the period
    assert age(sent, 99, 0.005, 99, 12.0) == pytest.approx(0.02)
    assert age(sent, 99, 0.005, 0, 12.0) == pytest.approx(2.0)
    assert math.isnan(age(sent, 99, 0.005, 100, 12.0))  # not published yet, or by another run


def test_of_what_is_long_past_the_age_is_at_least_known_to_be_large():
    sent = sent_at(0.006 * np.arange(3 * KEPT))
    assert age(sent, 3 * KEPT - 1, 0.005, 5, 0.006 * 3 * KEPT) >= 2 * KEPT * 0.005


@pytest.mark.parametrize(("pace", "period"), [("realtime", 0.005), ("scaled", 0.00125)])
def test_the_period_of_the_timed_paces(pace, period):
    assert PaceConfig(pace=pace, time_scale=4.0).period(0.005) == pytest.approx(period)
