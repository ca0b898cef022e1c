"""Late ticks, and the age of the state that a theta answers."""

import math

import pytest

from vdp_plant.config import PaceConfig
from vdp_plant.pacing import KEPT, SentStates, Ticks


def test_a_tick_that_took_the_place_of_others_counts_them():
    ticks = Ticks(0.005)
    ticks.start(10.0)
    # 1 ms late is not a period late; due at 10.02, three periods are gone
    assert [ticks.tick(now) for now in (10.005, 10.011, 10.0149, 10.0375, 10.04)] == [0, 0, 0, 3, 0]


def test_a_pause_is_not_late():
    ticks = Ticks(0.005)
    ticks.start(10.0)
    ticks.tick(10.005)
    ticks.start(20.0)
    assert ticks.tick(20.005) == 0


def test_the_age_of_an_answer_is_that_of_its_state():
    sent = SentStates(0.005)
    assert math.isnan(sent.age(0, 1.0))
    for k in range(100):
        sent.send(k, 10.0 + 0.02 * k)  # late ticks: slower than the period
    assert sent.age(99, 12.0) == pytest.approx(0.02)
    assert sent.age(0, 12.0) == pytest.approx(2.0)
    assert math.isnan(sent.age(100, 12.0))  # not published yet, or by another run


def test_of_what_is_long_past_the_age_is_at_least_known_to_be_large():
    sent = SentStates(0.005)
    for k in range(3 * KEPT):
        sent.send(k, 0.006 * k)
    assert sent.age(5, 0.006 * 3 * KEPT) >= 2 * KEPT * 0.005


@pytest.mark.parametrize(("pace", "period"), [("realtime", 0.005), ("scaled", 0.00125)])
def test_the_period_of_the_timed_paces(pace, period):
    assert PaceConfig(pace=pace, time_scale=4.0).period(0.005) == pytest.approx(period)
