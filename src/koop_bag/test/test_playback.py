"""When messages go out: decided by hand for short bags, without ROS and without waiting."""

import math
import random

import pytest
from koop_bag_messages import LOOP

from koop_bag.bag.playback import REORDER_WINDOW, Playback, Timeline, in_time_order
from koop_bag.bag.reader import BagReader, RawMessage
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.player.config import PlayerConfig, parse_remap
from koop_core.config.parameter import ConfigError

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000


def message(topic, milliseconds, data=b""):
    time = BEGIN + round(milliseconds * MS)
    return RawMessage(topic, time, time, 0, data)


def loop_messages(steps, period=5.0):
    """Return state, cost and theta of each step, 1 ms after one another."""
    return [
        message(topic, k * period + i, b"%d" % k)
        for k in range(steps)
        for i, topic in enumerate(("state", "cost", "theta"))
    ]


def playback(messages, **options):
    end = max((m.log_time for m in messages), default=BEGIN)

    def source(start):
        return iter([m for m in messages if m.log_time >= start])

    return Playback(source, BEGIN, options.pop("end", end), **options)


def drain(playing, now):
    taken = []
    while (found := playing.take(now)) is not None:
        taken.append(found)
    return taken


def play_through(playing, begin=100.0):
    """Return (message, time) of everything, jumping from one waiting time to the next."""
    now, out = begin, []
    playing.start(now)
    while not playing.finished:
        out += [(m, now) for m in drain(playing, now)]
        wait = playing.wait(now)
        if math.isinf(wait):
            break
        now += wait
    return out


@pytest.mark.parametrize("rate", [1.0, 0.25, 40.0])
def test_every_message_goes_out_at_its_time(rate):
    messages = loop_messages(20)
    out = play_through(playback(messages, rate=rate))
    assert [m for m, _ in out] == messages
    for m, now in out:
        # 1 us: what a float holds of seconds and the rounding of one waiting time
        assert (now - 100.0) * rate == pytest.approx((m.log_time - BEGIN) * 1e-9, abs=1e-6 * rate)


def test_a_pause_that_ends_before_the_start_lets_no_time_pass():
    messages = loop_messages(20)
    playing = playback(messages)
    playing.pause(0.0)
    playing.resume(50.0)  # who listens has not come yet
    playing.start(100.0)
    assert drain(playing, 100.0) == messages[:1]
    assert playing.wait(100.0) == pytest.approx(0.001)


def test_equal_times_keep_the_order_of_the_file():
    messages = [message(topic, k, bytes([i])) for k in range(3) for i, topic in enumerate("bacd")]
    assert list(in_time_order(messages)) == messages
    assert [m for m, _ in play_through(playback(messages))] == messages


def test_batches_written_by_a_recorder_are_put_in_order():
    rng = random.Random(1)
    messages = [message("t", k, b"%d" % k) for k in range(5000)]
    written = sorted(messages, key=lambda m: m.log_time + rng.randrange(100 * MS))
    assert written != messages
    assert list(in_time_order(written)) == messages


def test_a_message_far_out_of_place_comes_late_but_comes():
    messages = [message("t", 1000), message("t", 1500), message("t", 0), message("t", 1600)]
    assert sorted(in_time_order(messages)) == sorted(messages)


def test_as_fast_as_possible_waits_for_nothing():
    messages = loop_messages(100)
    assert {now for _, now in play_through(playback(messages, rate=math.inf))} == {100.0}


def test_after_a_stall_all_that_is_overdue_goes_out_at_once_and_in_order():
    messages = loop_messages(10)
    playing = playback(messages)
    playing.start(0.0)
    assert len(drain(playing, 0.0)) == 1
    assert drain(playing, 10.0) == messages[1:]
    assert playing.lateness == pytest.approx(10.0 - 0.047)


def test_a_pause_shifts_what_follows_by_its_length():
    messages = loop_messages(10)
    playing = playback(messages)
    playing.start(0.0)
    before = drain(playing, 0.0075)
    playing.pause(0.0075)
    assert drain(playing, 50.0) == []
    assert math.isinf(playing.wait(50.0))
    playing.resume(60.0)
    assert playing.wait(60.0) == pytest.approx(10e-3 - 7.5e-3)
    assert before + drain(playing, 70.0) == messages


def test_a_seek_goes_on_there():
    playing = playback(loop_messages(100))
    playing.start(0.0)
    playing.seek(BEGIN + 250 * MS, 0.0)
    assert drain(playing, 0.0)[0].data == b"50"
    drain(playing, 0.4)
    playing.seek(BEGIN + 100 * MS, 0.4)  # back
    assert [m.data for m in drain(playing, 0.4)] == [b"20"]
    assert playing.wait(0.4) == pytest.approx(1e-3)


def test_a_loop_begins_again_when_the_pass_is_over_not_when_its_last_message_went_out():
    messages = [message("t", 0), message("t", 10)]
    playing = playback(messages, end=BEGIN + 50 * MS, loop=True)
    playing.start(0.0)
    assert drain(playing, 0.02) == messages
    assert playing.wait(0.02) == pytest.approx(0.03)
    assert drain(playing, 0.105) == [*messages, messages[0]]
    assert playing.passes == 2
    playing.loop = False
    drain(playing, 0.2)
    assert playing.finished


def test_a_loop_over_one_message_leaves_time_for_others():
    playing = playback([message("map", 0)], loop=True)
    playing.start(0.0)
    assert len(drain(playing, 0.0)) == 1
    assert playing.wait(0.0) > 0.0


def test_a_bag_without_messages_is_finished_also_if_it_shall_loop():
    assert playback([], loop=True).finished


def test_only_the_chosen_stretch_is_played():
    messages = loop_messages(100)
    playing = playback(messages, end=BEGIN + 22 * MS)
    playing.seek(BEGIN + 10 * MS, 0.0)
    playing.start(0.0)
    assert {m.data for m in drain(playing, 9.0)} == {b"2", b"3", b"4"}
    assert playing.finished


def test_the_rate_changes_without_a_jump():
    timeline = Timeline(2.0)
    timeline.set(BEGIN, 0.0)
    timeline.run(0.0)
    assert timeline.bag_time(1.0) == BEGIN + 2000 * MS
    timeline.set_rate(0.5, 1.0)
    assert timeline.bag_time(1.0) == BEGIN + 2000 * MS
    assert timeline.due(BEGIN + 3000 * MS) == pytest.approx(3.0)


def test_stopped_and_started_again_it_goes_on_where_it_was():
    messages = loop_messages(10)
    playing = playback(messages)
    playing.start(0.0)
    before = drain(playing, 0.012)
    playing.stop(0.012)
    playing.start(99.0)
    assert playing.wait(99.0) == pytest.approx(3e-3)
    assert before + drain(playing, 200.0) == messages


def test_a_bag_is_iterated_in_time_order_or_in_that_of_its_file(tmp_path, messages):
    times = [10 * MS, 30 * MS, 20 * MS, 700 * MS]  # as a recorder writes batches
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/state", load_schema(LOOP["/state"]))
        for k, time in enumerate(times):
            writer.write(channel, BEGIN + time, BEGIN, messages.loop("/state", k))
    with BagReader(tmp_path / "bag") as bag:
        in_order, as_filed = (
            [(m.log_time - BEGIN) // MS for m in Playback.of_bag(bag, window=window)]
            for window in (REORDER_WINDOW, 0)
        )
    assert in_order == [10, 20, 30, 700]
    assert as_filed == [10, 30, 20, 700]


def test_options_in_words():
    assert parse_remap("/a:=/b state:=old/state") == {"/a": "/b", "state": "old/state"}
    assert PlayerConfig(pace="5").speed == 5.0
    assert PlayerConfig().speed == 1.0
    assert math.isinf(PlayerConfig(pace="fast").speed)


@pytest.mark.parametrize(
    "wrong", [{"remap": "/a=/b"}, {"position": -1.0}, {"pace": "warp"}, {"pace": "0"}]
)
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ConfigError):
        PlayerConfig(**wrong)
