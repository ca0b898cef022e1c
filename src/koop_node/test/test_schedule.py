"""Timers on a clock that the test sets."""

from types import SimpleNamespace

import pytest

from koop_node.node.schedule import SLICE, Schedule, current, running


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("koop_node.node.schedule.time", SimpleNamespace(monotonic=clock))
    return clock


@pytest.fixture
def schedule(clock):
    return Schedule()


def advance(clock, schedule, seconds):
    clock.now += seconds
    schedule.run_due()


def test_a_timer_is_due_every_period_from_its_start(clock, schedule):
    calls = []
    schedule.timer(0.5, lambda: calls.append(clock.now))
    for _ in range(12):
        advance(clock, schedule, 0.125)
    assert calls == [100.5, 101.0, 101.5]


def test_periods_that_are_past_are_dropped_and_the_rest_keeps_its_raster(clock, schedule):
    calls = []
    schedule.timer(0.5, lambda: calls.append(clock.now))
    advance(clock, schedule, 2.2)  # four are past
    assert calls == [102.2]
    advance(clock, schedule, 0.3)
    assert calls == [102.2, 102.5]


def test_timers_that_are_due_come_in_the_order_of_their_times(clock, schedule):
    calls = []
    for period in (0.3, 0.1, 0.2):
        schedule.timer(period, lambda period=period: calls.append(period))
    advance(clock, schedule, 0.35)
    assert calls == [0.1, 0.2, 0.3]


def test_after_a_slice_messages_have_their_turn_before_the_next_timer(clock, schedule):
    calls = []

    def work(number):
        calls.append(number)
        clock.now += 0.7 * SLICE

    for number, due in enumerate((0.1, 0.2, 0.2, 0.2, 0.3)):
        schedule.timer(1.0, lambda number=number: work(number)).restart(due=clock.now + due)
    advance(clock, schedule, 0.5)
    assert (calls, schedule.wait(1.0)) == ([0, 1, 2, 3], 0.0)  # one time: they stay together
    schedule.run_due()
    assert calls == [0, 1, 2, 3, 4]


def test_the_wait_is_that_for_the_next_timer_and_no_longer_than_asked_for(clock, schedule):
    assert schedule.wait(0.1) == 0.1
    schedule.timer(0.0625, lambda: None)
    assert schedule.wait(0.1) == 0.0625
    clock.now += 1.0
    assert schedule.wait(0.1) == 0.0


def test_a_cancelled_timer_is_not_due_until_it_is_restarted(clock, schedule):
    calls = []
    timer = schedule.timer(0.25, lambda: calls.append(clock.now))
    timer.cancel()
    advance(clock, schedule, 1.0)
    assert calls == []
    assert schedule.wait(9.0) == 9.0
    timer.restart(0.5)
    advance(clock, schedule, 0.25)
    assert calls == []
    advance(clock, schedule, 0.25)
    assert calls == [101.5]


def test_a_timer_may_cancel_itself_and_make_others(clock, schedule):
    calls = []

    def once():
        calls.append("once")
        timer.cancel()
        schedule.timer(0.25, lambda: calls.append("other"))

    timer = schedule.timer(0.25, once)
    for _ in range(3):
        advance(clock, schedule, 0.25)
    assert calls == ["once", "other", "other"]


def test_a_timer_without_a_period_is_due_each_time_and_does_not_keep_the_others_waiting(
    clock, schedule
):
    calls = []
    schedule.timer(0.0, lambda: calls.append("always"))
    schedule.timer(0.5, lambda: calls.append("sometimes"))
    advance(clock, schedule, 0.5)
    advance(clock, schedule, 0.25)
    assert calls == ["always", "sometimes", "always"]


def test_nodes_have_their_timers_on_the_schedule_that_runs():
    assert current() is None
    with running() as schedule:
        assert current() is schedule
    assert current() is None
