"""What the recorder takes in compiled code, beside what rclpy takes of the same topic."""

import ctypes
import os
import random
import struct
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict

import numpy as np
import pytest
import rclpy
from koop_bag_messages import LOOP, step_of
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from koop_bag.bag.losses import LossCounter
from koop_bag.mcap.chunk import CHANNEL, LOG_TIME, Batch
from koop_bag.recorder.drain import AT_ONCE, HAS_STEP, MOST, ROOM, STEP, Drain, count_steps
from koop_bag.recorder.topics import RecordedTopic, fetch, skip, subscribe, watch
from koop_core.journal import PATH, Journal, Topic, append, journal_of_process, make_journal
from koop_core.journal import ROOM as ROOM_OF_JOURNAL
from koop_node.node.managed import message_type

pytestmark = pytest.mark.ros

KIND = message_type(LOOP["/state"])
DEPTH = 10_000


@pytest.fixture
def node():
    context = rclpy.Context()
    context.init(args=[])
    node = Node("drained", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


def listen(node, topic):
    reliable, volatile = ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE
    return subscribe(node, KIND, topic, DEPTH, reliable, volatile)


def publisher_to(node, topic, listeners):
    publisher = node.create_publisher(KIND, topic, DEPTH)
    wait_for(lambda: publisher.get_subscription_count() == listeners)
    return publisher


def wait_for(look):
    deadline = time.monotonic() + 60.0
    while not look():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def take_with_rclpy(subscription):
    """Return the time when each was sent and the serialized message."""
    taken = []
    while (item := subscription.handle.take_message(KIND, True)) is not None:
        taken.append((item[1]["source_timestamp"], item[0]))
    return taken


def take_with_drain(drain, subscriptions, count):
    """Return what both were sent, by subscription, and the rows, once so many have come."""
    taken, rows = [[] for _ in subscriptions], [[] for _ in subscriptions]

    def look():
        before = time.time_ns()
        for number, some in enumerate(drain.take(subscriptions)):
            assert (some[:, CHANNEL] == number).all()
            batch = list(Batch(some, drain.data).rows())
            times = [row[0] for row in batch]
            assert times == sorted(times)
            assert all(sent <= received <= time.time_ns() for received, _, sent, _ in batch)
            assert all(received > before - 60e9 for received in times)
            taken[number] += [(sent, data) for _, _, sent, data in batch]
            rows[number].append(some.copy())
        return sum(map(len, taken)) == count

    wait_for(look)
    return taken, rows


def count_plainly(messages):
    """Return the counter of messages that were decoded one by one."""
    counter = LossCounter()
    for data in messages:
        with suppress(struct.error):
            counter.add(step_of(data))
    return counter


def damaged(rng, data):
    """Return a message, mostly damaged in some way."""
    cut = rng.randrange(len(data) + 1)
    return rng.choice(
        [
            data,
            data[:cut],
            data[:cut] + rng.randbytes(rng.randrange(40)),
            rng.randbytes(cut),
            data[:12] + rng.choice([b"\xff\xff\xff\xff", b"\x00\x01\x00\x00"]) + data[16:],
            data + rng.randbytes(rng.choice([1, 5_000, 70_000])),
            b"",
        ]
    )


def test_what_is_taken_is_what_rclpy_takes_damaged_or_of_any_size(node, messages, rng):
    drain, topics = Drain(), ("/one", "/two")
    drained = [listen(node, topic) for topic in topics]
    beside = [listen(node, topic) for topic in topics]
    publishers = [publisher_to(node, topic, 2) for topic in topics]
    sent = [[], []]
    for _ in range(20):
        count = rng.choice([0, 1, 30, 150])
        for k in range(count):
            which = rng.randrange(2)
            data = messages.loop("/state", k, frame_id="f" * rng.randrange(20))
            data = damaged(rng, data) if rng.random() < 0.3 else data
            publishers[which].publish(data)
            sent[which].append(data)
        taken, rows = take_with_drain(drain, drained, count)
        for number in range(2):
            expected = []
            while len(expected) < len(taken[number]):
                expected += take_with_rclpy(beside[number])
            assert taken[number] == expected
            counter = LossCounter()
            for some in rows[number]:
                count_steps(some, counter)
            plain = count_plainly([data for _, data in taken[number]])
            assert asdict(counter) == asdict(plain)
    assert sum(map(len, sent)) > 500


def test_no_topic_keeps_the_others_waiting_and_the_rest_comes_next(node, messages):
    drain = Drain()
    drained = [listen(node, topic) for topic in ("/one", "/two")]
    publishers = [publisher_to(node, topic, 1) for topic in ("/one", "/two")]
    data = messages.loop("/state", 1)
    for _ in range(AT_ONCE + 500):
        publishers[0].publish(data)
    publishers[1].publish(data)
    wait_for(lambda: all(p.wait_for_all_acked() for p in publishers))
    assert [len(rows) for rows in drain.take(drained)] == [AT_ONCE, 1]
    assert [len(rows) for rows in drain.take(drained)] == [500, 0]
    assert [len(rows) for rows in drain.take(drained)] == [0, 0]
    assert drain.take([]) == []


def test_large_messages_make_room_for_themselves_and_leave_it(node, rng):
    drain, drained = Drain(), listen(node, "/one")
    publisher = publisher_to(node, "/one", 1)
    sizes = (ROOM - 1, 1, ROOM, 3 * ROOM, MOST, 7)
    sent = [rng.randbytes(size) for size in sizes]
    for data in sent:
        publisher.publish(data)
    (taken,), _ = take_with_drain(drain, [drained], len(sent))
    assert [data for _, data in taken] == sent
    assert len(drain.data) > MOST
    publisher.publish(sent[-1])
    take_with_drain(drain, [drained], 1)
    assert len(drain.data) == ROOM


@ctypes.CFUNCTYPE(ctypes.c_int, *4 * [ctypes.c_void_p])
def take_untimed(subscription, message, info, allocation):
    """Take as rcl does, of a DDS that tells no time of reception, from a host an hour ahead."""
    take_message = ctypes.CDLL("librcl.so").rcl_take_serialized_message
    code = take_message(*map(ctypes.c_void_p, (subscription, message, info, allocation)))
    sent_and_received = (ctypes.c_int64 * 2).from_address(info)
    sent_and_received[0] += 3600 * 10**9
    sent_and_received[1] = 0
    return code


def test_without_a_time_of_reception_messages_have_that_of_their_poll(node, messages):
    names = ("/one", "/two")
    topics = [RecordedTopic(node, name, LOOP["/state"], DEPTH, lambda topic: 1) for name in names]
    publishers, drain = [publisher_to(node, name, 1) for name in names], Drain()
    drain._functions = ctypes.cast(take_untimed, ctypes.c_void_p).value, drain._functions[1]
    times = []
    for k in range(30):
        for publisher in publishers:
            publisher.publish(messages.loop("/state", k))
        wait_for(lambda: all(p.wait_for_all_acked() for p in publishers))
        before = time.time_ns()
        of_poll = fetch(drain, topics, {}).table[:, LOG_TIME].tolist()
        assert len(of_poll) == 2
        assert all(before <= received <= time.time_ns() for received in of_poll)
        times += of_poll
    assert times == sorted(times)


def rows_of(steps):
    """Return rows as the drain makes them; None is a damaged message."""
    table = np.zeros((len(steps), 7), np.int64)
    valid = np.array([step is not None for step in steps], bool)
    known = np.array([step or 0 for step in steps], np.uint64)
    table[:, STEP], table[:, HAS_STEP] = known.view(np.int64), valid
    return table


def test_losses_are_counted_as_message_by_message():
    rng = random.Random(11)
    for _ in range(2_000):
        counter, plain, step = LossCounter(), LossCounter(), rng.choice([0, 5, 2**63 - 3])
        for _ in range(rng.randrange(1, 6)):
            steps = []
            for _ in range(rng.choice([1, 2, 3, 50, 200])):
                odd = rng.random() < 0.03
                step = step + 1 if not odd else rng.choice([0, step, step + 3, step - 9, 2**64 - 1])
                step = max(0, min(step, 2**64 - 1))
                steps.append(None if rng.random() < 0.003 else step)
            if rng.random() < 0.5:
                steps = list(range(step, step + len(steps)))
                steps = [min(each, 2**64 - 1) for each in steps]
            count_steps(rows_of(steps), counter)
            for each in steps:
                if each is not None:
                    plain.add(each)
            if rng.random() < 0.1:
                counter.interrupt()
                plain.interrupt()
        assert asdict(counter) == asdict(plain)


def test_topics_are_merged_in_the_order_of_reception_and_channels_opened_in_it(node, messages):
    opened, drain = [], Drain()

    def announce(topic):
        opened.append(topic.name)
        return len(opened)

    names = ("/late", "/early", "/silent")
    topics = [RecordedTopic(node, name, LOOP["/state"], DEPTH, announce) for name in names]
    late, early, _ = [publisher_to(node, name, 1) for name in names]
    watched = {"/other": watch(node, "/other")}
    for k in range(3):
        early.publish(messages.loop("/state", k))
        time.sleep(0.002)
        late.publish(messages.loop("/state", 10 + k))
    wait_for(lambda: early.wait_for_all_acked() and late.wait_for_all_acked())
    rows = list(fetch(drain, topics, watched).rows())
    assert [(channel, step_of(data)) for _, channel, _, data in rows] == [
        (1, 0), (2, 10), (1, 1), (2, 11), (1, 2), (2, 12),
    ]  # fmt: skip
    assert opened == ["/early", "/late"]
    assert [topic.count for topic in topics] == [3, 3, 0]
    early.publish(messages.loop("/state", 9))
    wait_for(early.wait_for_all_acked)
    skip(drain, topics, watched)
    early.publish(messages.loop("/state", 12))
    wait_for(early.wait_for_all_acked)
    assert [row[1] for row in fetch(drain, topics, watched).rows()] == [1]
    assert (topics[1].losses.lost, topics[1].losses.inactive) == (0, 9)
    assert list(fetch(drain, [], {}).rows()) == []


@pytest.fixture
def journal():
    descriptor, environment = make_journal()
    yield Journal(environment[PATH])
    os.close(descriptor)


def write(place, data):
    """Write as compiled code does, from the message's own memory; False: there was no room."""
    return append(place, np.frombuffer(data, np.uint8).ctypes.data, len(data))


def take_journal(drain, taken):
    """Add to what was taken of topics 0 and 1; return how much."""
    count = 0
    for some, messages in zip(drain.take([0, 1]), taken, strict=True):
        rows = list(Batch(some, drain.data).rows())
        assert [row[0] for row in rows] == sorted(row[2] for row in rows)
        assert [step_of(row[3]) for row in rows] == some[:, STEP].tolist()
        messages += [row[3] for row in rows]
        count += len(rows)
    return count


def test_a_journal_gives_all_that_found_room_whole_and_in_order(journal, messages, rng):
    """Many times its size, with a reader that lags; of a third topic nobody takes."""
    drain = Drain(journal)
    names = ("/state", "/theta", "/other")
    places = [journal.place(Topic(name, "pkg/msg/Any", "/node")) for name in names]
    written, taken, bytes_written, refused = ([], []), ([], []), 0, 0
    number = 0
    while bytes_written < 5 * ROOM_OF_JOURNAL * 8:
        for _ in range(rng.choice([1, 100, 3000])):
            which, number = rng.randrange(3), number + 1
            data = messages.loop("/state", number, frame_id="f" * rng.randrange(3000))
            if write(places[which], data):
                bytes_written += len(data)
                if which < 2:
                    written[which].append(data)
            else:
                refused += 1
        for _ in range(rng.choice([0, 0, 1, 3])):
            take_journal(drain, taken)
    while take_journal(drain, taken):
        pass
    assert taken == written
    assert refused
    assert min(map(len, written)) > 1000


def test_rows_of_a_journal_count_losses_as_those_of_subscriptions_do(journal, messages):
    drain = Drain(journal)
    place = journal.place(Topic("/state", "pkg/msg/Any", "/node"))
    for steps in ([0, 1, 2], [3, 5, 6], [], [7]):
        for step in steps:
            assert write(place, messages.loop("/state", step))
        (rows,) = drain.take([0])
        assert rows[:, STEP].tolist() == steps


def test_what_a_killed_writer_has_written_is_read(messages):
    descriptor, environment = make_journal()
    code = (
        "import os, numpy as np\n"
        "from koop_core.journal import Topic, append, journal_of_process\n"
        "journal = journal_of_process()\n"
        "place = journal.place(Topic('/state', 'pkg/msg/Any', '/node'))\n"
        "for n in range(1000):\n"
        "    data = np.frombuffer(b'%04d' % n, np.uint8)\n"
        "    assert append(place, data.ctypes.data, 4)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], env=os.environ | environment)
    assert ended.returncode == -9
    journal = Journal(environment[PATH])
    os.close(descriptor)
    drain = Drain(journal)
    assert journal.topics() == [Topic("/state", "pkg/msg/Any", "/node")]
    (rows,) = drain.take([0])
    assert [row[3] for row in Batch(rows, drain.data).rows()] == [b"%04d" % n for n in range(1000)]


def test_a_journal_without_a_reader_keeps_nobody_waiting_one_that_is_gone_is_none(
    journal, messages, monkeypatch
):
    place = journal.place(Topic("/state", "pkg/msg/Any", "/node"))
    while write(place, messages.loop("/state", 1)):
        pass
    assert journal.read_within(0.0)
    journal.follow(0, "recorder")
    assert journal.readers() == {"/state": "recorder"}
    assert not journal.read_within(0.0)
    drain = Drain(journal)
    while len(drain.take([0])[0]):
        pass
    assert journal.read_within(0.0)
    monkeypatch.setenv(PATH, "/proc/self/fd/99999")
    assert journal_of_process() is None
