"""The age of messages: two clocks that know nothing of each other, cuts, drift, clocks set anew."""

import numpy as np
import pytest

from koop_core.stream.age import UNKNOWN, age
from koop_core.stream.arrival import Arrival
from koop_core.stream.monitor import StreamMonitor

DT = 0.005
LIMIT = 0.5
OFFSETS = [0.0, 1.7e9, -3600.0]  # [s] of the writer's clock against the reader's steady one


def ages(written, arrived, offset=0.0):
    clocks, told = UNKNOWN, []
    for w, a in zip(written, arrived, strict=True):
        old, clocks = age(clocks, w + offset, a)
        told.append(old)
    return np.array(told)


def over_a_cut(length, spacing, begin=30.0, end=60.0, latency=0.002, keep=np.inf):
    """Return when messages are written and arrive over a link that is cut; it keeps the newest.

    What was kept arrives with the given spacing, and what comes meanwhile waits for its turn.
    """
    written = np.arange(0.0, begin + length + end, DT)
    arrived = written + latency
    kept = (written >= begin) & (written < begin + length) & (written >= begin + length - keep)
    lost = (written >= begin) & (written < begin + length) & ~kept
    written, arrived = written[~lost], arrived[~lost]
    free = begin + length
    for i in np.flatnonzero(written >= max(begin, begin + length - keep)):
        arrived[i] = free = max(arrived[i], free + spacing)
    return written, arrived


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("length", [0.2, 8.0, 25.0, 3600.0])
@pytest.mark.parametrize("spacing", [1e-5, 1e-3, 2.5e-3])  # at once, five times and twice as fast
def test_what_a_cut_held_up_has_the_age_that_it_has(offset, length, spacing):
    written, arrived = over_a_cut(length, spacing, keep=60.0)
    np.testing.assert_allclose(ages(written, arrived, offset), arrived - written - 0.002, atol=1e-6)


def test_jitter_is_no_more_than_it_is():
    written = np.arange(0.0, 300.0, DT)
    jitter = np.random.default_rng(0).exponential(0.03, written.size)
    arrived = np.maximum.accumulate(written + jitter)
    assert ages(written, arrived).max() < LIMIT


@pytest.mark.parametrize("drift", [1e-3, -1e-3])
def test_a_clock_that_drifts_makes_nothing_old(drift):
    arrived = np.arange(0.0, 3600.0, 0.1)
    assert ages(arrived * (1.0 + drift), arrived).max() < 0.05


@pytest.mark.parametrize("jump", [2.0, 3600.0, 1.7e9])
def test_a_clock_that_is_set_back_makes_messages_old_for_half_a_minute_at_most(jump):
    arrived = np.arange(0.0, 120.0, DT)
    actual = ages(np.where(arrived < 40.0, arrived, arrived - jump), arrived)
    assert actual[arrived < 40.0].max() < LIMIT
    assert actual[(arrived > 40.0) & (arrived < 45.0)].min() > LIMIT
    assert actual[arrived > 70.0].max() < LIMIT


def test_a_clock_that_is_set_forward_costs_nothing():
    arrived = np.arange(0.0, 60.0, DT)
    assert ages(np.where(arrived < 30.0, arrived, arrived + 3600.0), arrived).max() < 1e-6


def test_a_link_that_lets_only_a_few_through_at_a_time_does_not_become_normal():
    """Ten times, some of what was kept for a minute arrives, then nothing for 15 s."""
    clocks = UNKNOWN
    for k in range(8000):
        _, clocks = age(clocks, k * DT, k * DT)
    step = 8000
    for burst in range(10):
        now = 100.0 + 15.0 * burst
        for k in range(100):
            old, clocks = age(clocks, (step + k) * DT, now + 1e-4 * k)
            assert old > 50.0
        step += 100


def test_the_monitor_refuses_what_is_stale_on_arrival_as_if_it_had_never_come():
    monitor = StreamMonitor("state", LIMIT, DT)
    for k in range(100):
        assert monitor.hear(k, 0.0, k * DT, k * DT) != Arrival.TOO_OLD
    kinds = [monitor.hear(100 + k, 0.0, 10.0, (100 + k) * DT) for k in range(1900)]
    assert kinds == [Arrival.TOO_OLD] * 1800 + [Arrival.RESUME] + [Arrival.NEXT] * 99
    assert (monitor.too_old, monitor.missed, monitor.count) == (1800, 1800, 200)


def test_a_source_that_waits_and_a_timeout_of_0_know_no_age():
    monitor = StreamMonitor("state", LIMIT, DT)
    monitor.hear(0, 0.0, 0.0, 0.0)
    assert monitor.hear(1, 0.0, 100.0) == Arrival.NEXT
    monitor.timeout = 0.0
    assert monitor.hear(2, 0.0, 200.0, 0.1) == Arrival.NEXT


def test_a_source_that_starts_again_has_another_clock():
    monitor = StreamMonitor("state", LIMIT, DT)
    for k in range(200):
        monitor.hear(k, 0.0, k * DT, 100.0 + k * DT)
    assert monitor.hear(0, 0.0, 2.0, 50.0) == Arrival.RESTART
    assert monitor.hear(1, 0.0, 2.005, 50.005) == Arrival.NEXT


def test_messages_that_are_too_old_do_not_end_the_silence():
    monitor = StreamMonitor("state", LIMIT, DT)
    monitor.hear(0, 0.0, 0.0, 0.0)
    monitor.hear(1, 0.0, 10.0, DT)
    assert monitor.stale(10.0)
    assert monitor.values(10.0, 0.0, 1)["state too_old"] == 1
    assert any("1 too old on 'state'" in f.text for f in monitor.findings(10.0, 1))
