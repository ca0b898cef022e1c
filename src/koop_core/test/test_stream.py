"""The monitor of an input: steps that repeat, go back, arrive late; ages and timeouts."""

import math

import pytest

from koop_core.stream.arrival import Arrival
from koop_core.stream.monitor import StreamMonitor
from koop_core.stream.report import ERROR, OK, STALE, WARN, NodeFinding, summary
from koop_core.stream.settings import STREAM

NEXT, RESUME, RESTART, JOIN, REPEAT, LATE, TOO_OLD = Arrival

DT = 0.005


def feed(monitor, steps):
    return [monitor.hear(k, k * DT, 0.1 * i) for i, k in enumerate(steps)]


@pytest.fixture
def monitor():
    return StreamMonitor("state", 0.5, DT)


def test_consecutive_steps_follow_on_each_other(monitor):
    assert feed(monitor, range(7, 12)) == [JOIN, NEXT, NEXT, NEXT, NEXT]
    assert (monitor.missed, monitor.restarts, monitor.count) == (0, 0, 5)


def test_lost_steps_are_counted_and_the_next_one_still_follows(monitor):
    assert feed(monitor, [0, 1, 5, 6]) == [RESTART, NEXT, NEXT, NEXT]
    assert monitor.missed == 3


@pytest.mark.parametrize("first", [20, 2000])
def test_steps_that_pass_while_nobody_listens_are_not_missed(monitor, first):
    feed(monitor, [0, 1])
    monitor.pause()
    feed(monitor, [first, first + 1, first + 4])
    assert monitor.missed == 2
    texts = [finding.text for finding in monitor.findings(0.3, 1)]
    assert texts == ["2 missed on 'state'"]


def test_a_gap_longer_than_the_timeout_follows_on_nothing(monitor):
    at_the_limit, beyond = 100, 201  # 0.5 s and 0.505 s
    assert feed(monitor, [0, at_the_limit, beyond]) == [RESTART, NEXT, RESUME]
    assert monitor.silences == 1


def test_a_step_that_no_run_reaches_is_unusable_and_nothing_follows_on_it(monitor):
    assert feed(monitor, [0, 2**64 - 1, 2**63 - 1, 1]) == [RESTART, TOO_OLD, TOO_OLD, NEXT]
    assert (monitor.unusable, monitor.missed) == (2, 0)


def test_only_the_steps_decide_what_follows(monitor):
    assert monitor.hear(4, 1000.0, 0.0) == JOIN
    assert monitor.hear(5, 0.0, 99.0) == NEXT  # neither the clock nor the stamp: a replay is alike


def test_a_timeout_of_0_is_off(monitor):
    monitor.timeout = 0.0
    assert feed(monitor, [0, 100_000]) == [RESTART, NEXT]
    assert not monitor.stale(1e9)
    assert monitor.watchdog(1e9) == "off"


def test_overtaken_messages_are_late_and_repeated_ones_repeat(monitor):
    assert feed(monitor, [10, 12, 11, 12, 13]) == [JOIN, NEXT, LATE, REPEAT, NEXT]
    assert (monitor.late, monitor.repeated, monitor.step) == (1, 1, 13)


def test_a_source_that_starts_again_is_another_run(monitor):
    assert feed(monitor, [0, 1, 2, 0, 1]) == [RESTART, NEXT, NEXT, RESTART, NEXT]
    assert feed(monitor, [5000, 37, 38]) == [RESUME, JOIN, NEXT]
    assert monitor.restarts == 2


def test_only_step_0_is_where_a_run_begins(monitor):
    assert feed(monitor, [0]) == [RESTART]
    assert feed(StreamMonitor("state", 0.5, DT), [1, 2]) == [JOIN, NEXT]
    assert feed(monitor, [90_000, 70_000, 70_001, 0, 1]) == [RESUME, JOIN, NEXT, RESTART, NEXT]


def test_a_bag_loop_shorter_than_the_window_is_noticed_after_the_window(monitor):
    kinds = feed(monitor, [30, *range(10, 30), *range(10, 30), *range(10, 30), *range(10, 30)])
    assert kinds.index(JOIN, 1) == STREAM.window + 1
    assert kinds[-1] in (NEXT, LATE)


def test_two_sources_in_turn_never_follow_on_each_other(monitor):
    steps = [s for k in range(50) for s in (1000 + k, 9000 + k)]
    assert NEXT not in feed(monitor, steps)


def test_ages_and_staleness_are_of_the_steady_clock(monitor):
    assert math.isnan(monitor.age(5.0))
    assert monitor.watchdog(5.0) == "waiting"
    monitor.hear(0, 0.0, 10.0)
    assert monitor.age(10.5) == pytest.approx(0.5)
    assert not monitor.stale(10.5)
    assert monitor.stale(10.51)
    assert [f.level for f in monitor.findings(11.0, 1)] == [STALE]


def test_latency_is_from_stamp_to_arrival_and_unknown_for_simulated_stamps(monitor):
    monitor.hear(0, 1_700_000_000.0, 10.0)
    assert monitor.latency(10.3, 1_700_000_000.302) == pytest.approx(0.002, abs=1e-6)
    monitor.hear(0, 0.0, 10.0)
    assert math.isnan(StreamMonitor("state", 0.0, DT).latency(10.0, 1_700_000_000.0))


def test_what_was_never_heard_is_not_ok_and_the_log_says_so_only_if_it_lasts(monitor):
    assert list(monitor.findings(1.0, 0)) == [
        NodeFinding(WARN, "nothing on 'state' yet: no publisher", at_once=False)
    ]
    unheard = "'/state' is published by /rig as std_msgs/msg/Float64"
    assert list(monitor.findings(1.0, 1, unheard=[unheard])) == [NodeFinding(ERROR, unheard)]
    monitor.hear(0, 0.0, 1.1)
    assert list(monitor.findings(1.2, 1)) == []


def test_a_source_that_has_nothing_more_to_say_has_ended():
    monitor = StreamMonitor("cost", 0.5, DT, may_end=True)
    monitor.hear(7, 0.0, 1.0)
    (actual,) = monitor.findings(2.0, 1, can_say_more=False)
    assert actual == NodeFinding(OK, "'cost' has ended at step 7")


def test_where_the_newest_counts_a_gap_is_counted_and_no_finding():
    """A writer of depth 1 leaves out what a newer one has replaced: that is by design."""
    monitor = StreamMonitor("theta", 0.5, DT, newest_counts=True)
    feed(monitor, [0, 1, 5, 4, 6])
    assert (monitor.missed, monitor.late) == (3, 1)
    assert list(monitor.findings(0.5, 1)) == []


def test_findings_tell_what_is_new(monitor):
    feed(monitor, [0, 3, 2, 3])
    monitor.reject("step 3: is not finite")
    levels = [finding.level for finding in monitor.findings(0.3, 2)]
    assert levels == [ERROR, ERROR, WARN, WARN, WARN]
    assert list(monitor.findings(0.3, 1)) == []


def test_the_summary_is_the_most_urgent():
    findings = [
        NodeFinding(OK, "fine"),
        NodeFinding(WARN, "w"),
        NodeFinding(ERROR, "e"),
        NodeFinding(STALE, "s"),
    ]
    assert summary(findings) == NodeFinding(ERROR, "e; s; w")
    assert summary(findings[:1]) == NodeFinding(OK, "fine")
    assert summary([]) == NodeFinding(OK, "")


def test_the_kinds_that_are_processed_come_first():
    assert max(NEXT, RESUME, RESTART, JOIN) < REPEAT < min(LATE, TOO_OLD)


def test_a_source_that_left_in_order_has_ended_and_one_that_was_lost_is_stale():
    left, lost = (StreamMonitor("state", 0.5, DT, may_end=True) for _ in range(2))
    for monitor in (left, lost):
        monitor.hear(20_000, 0.0, 10.0)
        assert list(monitor.findings(10.4, 1)) == []
        assert [f.level for f in monitor.findings(12.0, 1)] == [STALE]  # slow to leave, or killed
    assert list(left.findings(13.0, 0)) == [NodeFinding(OK, "'state' has ended at step 20000")]
    # discovery still counts it, for 20 s
    assert [f.level for f in lost.findings(29.0, 1)] == [STALE]
    assert [f.level for f in lost.findings(40.0, 0)] == [STALE]
    lost.hear(0, 0.0, 50.0)  # came back, and leaves in order
    assert next(lost.findings(51.0, 0)).level == OK


def test_for_the_actuator_no_silence_is_in_order():
    monitor = StreamMonitor("theta", 0.5, DT)
    monitor.hear(0, 0.0, 10.0)
    assert [f.level for f in monitor.findings(11.0, 0)] == [STALE]
