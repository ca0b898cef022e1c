"""Bags read back by readers that share no code with the writer."""

import os
import resource
import shutil
import signal
import struct
import sys
import zlib
from collections import Counter
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import yaml
import zstandard
from koop_bag_messages import LOOP, PERIOD, START, Messages
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex, Metadata
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from koop_bag.bag.earlier import EarlierRuns, find_earlier
from koop_bag.bag.losses import count_losses
from koop_bag.bag.metadata import OfferedQos
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagWriteError
from koop_core.config.parameter import ConfigError

MESSAGES = Messages()


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_rosbags_decodes_every_message(write_loop, compression):
    folder = write_loop(n=700, compression=compression)
    steps = {topic: [] for topic in LOOP}
    with AnyReader([folder]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == LOOP
        for connection, _, raw in reader.messages():
            steps[connection.topic].append(reader.deserialize(raw, connection.msgtype).step)
    assert all(actual == list(range(700)) for actual in steps.values())


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_mcap_ros2_support_decodes_every_message_with_checksums_on(write_loop, compression):
    folder = write_loop(n=700, compression=compression)
    with open(folder / "run_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        statistics = reader.get_summary().statistics
        assert statistics.message_count == 2800
        assert statistics.chunk_count == len(reader.get_summary().chunk_indexes) > 4
        observed = Counter()
        for _, channel, message, decoded in reader.iter_decoded_messages():
            k = observed[channel.topic]
            assert (decoded.step, message.sequence) == (k, k + 1)
            assert message.log_time - message.publish_time == 500
            observed[channel.topic] += 1
    assert observed == dict.fromkeys(LOOP, 700)


def test_the_indexes_lead_to_the_messages_of_a_time_range(write_loop):
    folder = write_loop(n=700)
    begin, end = START + 300 * PERIOD, START + 310 * PERIOD
    with open(folder / "run_0.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        actual = reader.iter_decoded_messages("/theta", starting_at=begin, ending_before=end)
        assert [decoded.step for *_, decoded in actual] == list(range(300, 310))


def test_every_index_entry_points_at_its_message(write_loop):
    folder = write_loop(n=300)
    with open(folder / "run_0.mcap", "rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    entries = 0
    for record in records:
        if isinstance(record, Chunk):
            chunk = zstandard.decompress(record.data, record.uncompressed_size)
        elif isinstance(record, MessageIndex):
            for log_time, offset in record.records:
                opcode, _, channel, _, logged = struct.unpack_from("<BQHIQ", chunk, offset)
                assert (opcode, channel, logged) == (Opcode.MESSAGE, record.channel_id, log_time)
                entries += 1
    assert entries == 1200


def test_the_checksum_of_the_summary_is_right(write_loop):
    data = (write_loop() / "run_0.mcap").read_bytes()
    # the specification: from the start of the summary up to the checksum in the footer
    start, _, crc = struct.unpack_from("<QQI", data, len(data) - 8 - 20)
    assert crc == zlib.crc32(data[start : len(data) - 8 - 4])


def test_the_whole_file_passes_a_sequential_reader_with_checksums_on(write_loop):
    folder = write_loop(n=300)
    with open(folder / "run_0.mcap", "rb") as stream:
        kinds = Counter(type(r).__name__ for r in StreamReader(stream, validate_crcs=True).records)
    assert kinds["Message"] == 1200
    assert kinds["Footer"] == 1


def test_the_description_says_what_is_in_the_bag(tmp_path, messages):
    qos = OfferedQos(reliability="best_effort", depth=5, deadline=(1, 500))
    folder = tmp_path / "run"
    with BagWriter(folder) as writer:
        channel = writer.add_topic("/state", load_schema(LOOP["/state"]), [qos])
        writer.custom_data["operator"] = "one: line\nand another"
        writer.write(channel, START, START - 10, messages.loop("/state", 0))
        writer.write(channel, START + 7, START, messages.loop("/state", 1))
    info = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["version"] == 9
    assert info["message_count"] == 2
    assert info["duration"]["nanoseconds"] == 7
    assert info["relative_file_paths"] == ["run_0.mcap"]
    assert info["custom_data"] == {"operator": "one: line\nand another"}
    (topic,) = info["topics_with_message_count"]
    assert topic["topic_metadata"]["offered_qos_profiles"] == [qos.as_map()]
    with AnyReader([folder]) as reader:  # its own reading of the embedded and the outer QoS
        (profile,) = reader.connections[0].ext.offered_qos_profiles
        assert (profile.reliability.name, profile.depth) == ("BEST_EFFORT", 5)
        assert profile.deadline.sec == 1
    (folder / "metadata.yaml").unlink()
    with BagReader(folder) as reader:  # from the copy inside the file
        assert reader.description["custom_data"] == info["custom_data"]


def test_a_bag_splits_by_size_and_every_file_stands_alone(write_loop):
    folder = write_loop(n=2000, compression="none", split_bytes=200_000)
    files = sorted(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)
    assert [path.name for path in files] == [f"run_{i}.mcap" for i in range(len(files))]
    assert len(files) >= 4
    for path in files[:-1]:  # a file ends with the chunk that made it too large
        assert 200_000 <= path.stat().st_size < 200_000 + 2 * 65536 + 20_000
    total = 0
    for path in files:
        with open(path, "rb") as stream:
            total += make_reader(stream, validate_crcs=True).get_summary().statistics.message_count
    assert total == 8000
    with AnyReader([folder]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) == 8000


def record(folder, n, earlier=None, **options):
    """Write n messages of /state and, from the middle on, of /cost; yield after each second."""
    options = WriterOptions(compression="none", **options)
    with BagWriter(folder, options, earlier=earlier) as writer:
        topics = {"/state": writer.add_topic("/state", load_schema(LOOP["/state"]))}
        for k in range(n):
            if k == n // 2:
                topics["/cost"] = writer.add_topic("/cost", load_schema(LOOP["/cost"]))
            for topic, channel in topics.items():
                now = START + k * PERIOD
                writer.write(channel, now, now, MESSAGES.loop(topic, k))
            if k % 200 == 199:
                yield writer


def read_steps(folder):
    """Return the steps by topic as rosbags reads them, checked against the bag's description."""
    info = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    actual, times = {}, []
    with AnyReader([folder]) as reader:
        for connection, time, raw in reader.messages():
            step = reader.deserialize(raw, connection.msgtype).step
            actual.setdefault(connection.topic, []).append(step)
            times.append(time)
    described = {
        topic["topic_metadata"]["name"]: topic["message_count"]
        for topic in info["topics_with_message_count"]
        if topic["message_count"]
    }
    assert described == {topic: len(steps) for topic, steps in actual.items()}
    assert info["message_count"] == len(times)
    assert info["starting_time"]["nanoseconds_since_epoch"] == min(times)
    assert info["duration"]["nanoseconds"] == max(times) - min(times)
    assert info["relative_file_paths"] == [file["path"] for file in info["files"]]
    return actual


def test_a_ring_by_size_keeps_the_newest_files_and_describes_them_truly(tmp_path):
    folder, keep = tmp_path / "run", 200_000
    for seconds, writer in enumerate(record(folder, 5_000, keep_bytes=keep), start=1):
        assert writer.bytes_written == sum(f.stat().st_size for f in folder.glob("*.mcap"))
        # a file may outgrow its part by the chunk in progress, its summary and its description
        assert writer.bytes_written < keep + 40_000
        if seconds in (12, 20):  # read while it is recorded
            steps = read_steps(folder)["/state"]
            assert steps == list(range(steps[0], steps[-1] + 1))
            assert steps[0] > 0
    steps = read_steps(folder)
    for topic in ("/state", "/cost"):  # a file may end between the two
        assert steps[topic] == list(range(steps[topic][0], 5_000))
    assert sum(f.stat().st_size for f in folder.glob("*.mcap")) > keep / 2
    with BagReader(folder) as reader:
        assert reader.complete
        assert [m.sequence for m in reader.messages(["/state"])] == [k + 1 for k in steps["/state"]]
    assert count_losses(steps["/state"]).lost == 0


def test_a_ring_by_age_keeps_what_is_younger_and_little_more(tmp_path):
    folder, keep = tmp_path / "run", 5.0
    for _ in record(folder, 4_000, keep_seconds=keep):  # 20 s
        pass
    steps = read_steps(folder)["/state"]
    assert steps == list(range(steps[0], 4_000))
    # the oldest file may be a tenth older, the next one is not yet complete
    assert keep <= len(steps) * PERIOD * 1e-9 <= 1.3 * keep


def test_a_ring_that_was_killed_is_read_as_far_as_it_was_written(tmp_path):
    copy = tmp_path / "copy"
    for writer in record(tmp_path / "run", 4_000, keep_bytes=300_000):
        if writer.topics[-1].channel.topic == "/cost" and not copy.exists():  # in the middle
            shutil.copytree(tmp_path / "run", copy)
    with BagReader(copy) as reader:
        assert not reader.complete
        files = [path.name for path in reader.files]
        assert reader.description["relative_file_paths"] == files
        torn = [m.sequence for m in reader.messages(["/state"])]
    recover(copy, tmp_path / "whole")
    assert read_steps(tmp_path / "whole")["/state"] == [number - 1 for number in torn]


def test_the_files_around_an_alarm_are_kept_apart_when_the_ring_drops_them(tmp_path):
    folder, alarms = tmp_path / "run", []
    for seconds, writer in enumerate(record(folder, 10_000, keep_bytes=400_000), start=1):
        if seconds in (4, 15):
            writer.note_alarm()
            alarms.append(seconds * 200)
        if seconds == 22:
            first = read_steps(folder / "alarms")["/state"]
    assert first == list(range(first[0], first[-1] + 1))
    steps = read_steps(folder / "alarms")["/state"]
    for alarm in alarms:
        assert set(range(alarm - 50, alarm + 50)) <= set(steps)  # a file holds 60 or more
    # one file before, the one in progress and one after; of all files the rest is dropped
    assert len(list((folder / "alarms").glob("*.mcap"))) == 6
    assert len(list(folder.glob("*.mcap"))) <= 21 - 6
    assert read_steps(folder)["/state"][-1] == 9_999


def test_alarms_without_end_take_half_of_the_ring_and_the_newest_files_the_other(tmp_path):
    folder, keep = tmp_path / "run", 400_000
    for seconds, writer in enumerate(record(folder, 12_000, keep_bytes=keep), start=1):
        writer.note_alarm()
        size = sum(path.stat().st_size for path in folder.rglob("*.mcap"))
        assert writer.bytes_written == size < keep + 40_000
        if seconds == 30:
            assert writer.alarms_full
            before = len(list(folder.glob("*.mcap")))
            writer.make_room(writer.options.reserve - 1)  # what is dropped now makes room
            assert len(list(folder.glob("*.mcap"))) >= before - 1
        if seconds == 40:  # a user takes two away: the next ones are kept
            kept = sorted(folder.glob("alarms/*.mcap"))
            shutil.copytree(folder / "alarms", tmp_path / "copy")
            for path in kept[:2]:
                path.unlink()
    steps = read_steps(tmp_path / "copy")["/state"]
    assert steps == list(range(len(steps)))  # the first ones stay
    assert 0.4 * keep < sum(f.stat().st_size for f in tmp_path.glob("copy/*.mcap")) < 0.5 * keep
    assert len(set(folder.glob("alarms/*.mcap")) - set(kept)) == 2
    assert read_steps(folder)["/state"][-1] == 11_999
    assert writer.alarms_full


def test_a_ring_holds_for_all_runs_of_a_loop_but_what_is_running_and_of_alarms(tmp_path):
    """Failed before: a loop that was started again and again filled the disk."""
    keep = 400_000

    def run(number, name="rig", messages=2_200):
        folder = tmp_path / f"20260101T00000{number}Z-{name}"
        (folder / "summary").mkdir(parents=True)
        earlier = EarlierRuns(find_earlier(folder))
        return folder / "bag", record(folder / "bag", messages, earlier, keep_bytes=keep)

    def files(*bags):
        names = [[path.name for path in bag.rglob("*.mcap")] for bag in bags]
        return [sorted(each, key=lambda name: (len(name), name)) for each in names]

    def size(*bags):
        return sum(path.stat().st_size for bag in bags for path in bag.rglob("*.mcap"))

    other, writers = run(1, "other")
    for _ in writers:
        pass
    whole, copy = files(other), tmp_path / "20260101T000002Z-rig"
    shutil.copytree(other.parent, copy)  # of the same loop, but no ring
    (copy / "summary").rmdir()
    running, going_on = run(3, messages=600)
    next(going_on)
    untouched = files(running)
    first, writers = run(4, messages=1_000)
    for seconds, writer in enumerate(writers, start=1):
        if seconds == 3:
            writer.note_alarm()
    states = files(first)
    second, writers = run(5, messages=8_000)
    for _ in writers:
        assert size(first, second) < keep + 40_000
        states += files(first)
    assert files(other, copy / "bag") == 2 * whole
    kept = states[-1]
    assert len(kept) == 3 < len(states[0])
    with BagReader(first) as reader:
        steps = {m.sequence - 1 for m in reader.messages(["/state"])}
    assert set(range(550, 650)) <= steps  # the alarm came at 600
    for state in states:  # the oldest went first
        gone = [name for name in states[0] if name not in state]
        assert gone == [name for name in states[0] if name not in kept][: len(gone)]
    assert files(running) == untouched
    assert read_steps(second)["/state"][-1] == 7_999
    for _ in going_on:
        pass
    assert read_steps(running)["/state"][-1] == 599
    third, writers = run(6, messages=8_000)
    for _ in writers:
        assert size(running, first, second, third) < keep + 40_000
    assert files(running, second) == [[], []]
    assert files(first)[0] == kept


FILE_EVENTS = ("os.mkdir", "os.link", "os.rename", "os.remove")


def die_in_a_drop(folder, survived):
    """Record with an alarm; end by SIGKILL before a file is touched once more in the first drop."""
    seen = 0

    def hook(event, arguments):
        nonlocal seen
        writes = event == "open" and arguments[1] in ("w", "xb")
        is_drop = seen or (event == "os.mkdir" and str(arguments[0]).endswith("alarms"))
        if is_drop and (writes or event in FILE_EVENTS):
            seen += 1
            if seen > survived:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    for writer in record(folder, 5_000, keep_bytes=200_000):
        if writer.message_count < 250:
            writer.note_alarm()
    os._exit(0)


@pytest.mark.parametrize("survived", range(10))
def test_a_kill_at_any_step_of_keeping_a_file_apart_loses_nothing(tmp_path, survived):
    folder = tmp_path / "run"
    if (child := os.fork()) == 0:
        die_in_a_drop(folder, survived)
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    steps = set(read_steps(folder)["/state"])
    if (folder / "alarms" / "metadata.yaml").exists():
        steps |= set(read_steps(folder / "alarms")["/state"])
    assert steps == set(range(min(steps), max(steps) + 1))
    assert min(steps) < 150 < 250 < max(steps)  # the alarm came at 200


def test_a_ring_on_a_disk_that_fills_up_shrinks_to_its_newest_file(tmp_path):
    folder, keep = tmp_path / "run", 200_000
    for seconds, writer in enumerate(record(folder, 5_000, keep_bytes=keep), start=1):
        before = sorted(path.name for path in folder.glob("*.mcap"))
        writer.make_room(keep // 10)
        assert sorted(path.name for path in folder.glob("*.mcap")) == before
        if seconds == 12:
            writer.make_room(0)  # the first two make room for the next one
            after = sorted(path.name for path in folder.glob("*.mcap"))
            assert set(after) < set(before)
            assert len(after) >= len(before) - 2
        if seconds >= 16:  # another program takes what becomes free
            for _ in range(20):
                writer.make_room(0)
            assert len(list(folder.glob("*.mcap"))) == 2
            steps = read_steps(folder)["/state"]
            assert steps == list(range(steps[0], steps[-1] + 1))
    steps = read_steps(folder)["/state"]
    assert steps == list(range(steps[0], 5_000))


def descriptions(path):
    """Return all descriptions that a file holds, in their order."""
    actual = []
    with open(path, "rb") as stream, suppress(EndOfFile):  # the file may still be written
        for record in StreamReader(stream).records:
            if isinstance(record, Metadata):
                actual.append(yaml.safe_load(record.metadata["serialized_metadata"]))
    return actual


def test_every_file_says_from_its_begin_what_the_bag_is(tmp_path, messages):
    options = WriterOptions(compression="none", split_bytes=16_000)  # 0.5 s
    with BagWriter(tmp_path / "run", options) as writer:
        channel = writer.add_topic("/state", load_schema(LOOP["/state"]))
        (opened,) = descriptions(tmp_path / "run" / "run_0.mcap")
        assert (opened["ros_distro"], opened["message_count"]) == (os.environ["ROS_DISTRO"], 0)
        writer.keep({"parameters": "a: 1"})
        for k in range(300):  # 1.5 s
            now = START + k * PERIOD
            writer.write(channel, now, now, messages.loop("/state", k))
        writer.keep({"models": "b"})
    files = sorted((tmp_path / "run").glob("*.mcap"))
    assert len(files) == 3
    for path in files:
        *_, last = descriptions(path)
        assert last["custom_data"]["parameters"] == "a: 1"
    assert descriptions(files[1])[0]["custom_data"] == {"parameters": "a: 1"}
    outer = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())
    assert last == outer["rosbag2_bagfile_information"]
    assert last["custom_data"] == {"parameters": "a: 1", "models": "b"}


def test_no_message_is_logged_before_the_last_one_of_the_file_before(tmp_path, messages):
    # of two topics one may be fetched late: its messages were received before others on the disk
    delays = {"/a": 0, "/b": 42_000}
    options = WriterOptions(compression="none", split_bytes=30_000)  # more than half of it
    with BagWriter(tmp_path / "run", options) as writer:
        channels = [(writer.add_topic(t, load_schema(LOOP["/state"])), t) for t in delays]
        for k in range(200):
            for channel, topic in channels:
                received = START + k * PERIOD - delays[topic]
                writer.write(channel, received, received, messages.loop("/state", k))
    with BagReader(tmp_path / "run") as reader:
        actual = list(reader.messages())
    assert [m.sequence for m in actual if m.topic == "/b"] == list(range(1, 201))
    changed = [m for m in actual if m.log_time != m.publish_time]
    times = []
    for path in sorted((tmp_path / "run").glob("*.mcap")):
        with BagReader(path) as file:
            times += [file.start_time, file.end_time]
    assert len(times) == 4
    assert times == sorted(times)
    # the one that straddles the boundary is logged when it was written, no other is touched
    assert [(m.topic, m.log_time) for m in changed] == [("/b", times[1])]


def test_the_file_names_who_wrote_it(write_loop):
    with open(write_loop(n=1) / "run_0.mcap", "rb") as stream:
        assert make_reader(stream).get_header().library.startswith("koop_bag ")


def test_sequence_numbers_go_on_across_files(write_loop):
    folder = write_loop(n=1000, split_bytes=4_000)
    with BagReader(folder) as reader:
        assert len(reader.files) > 10  # and 10 comes after 9, not after 1
        actual = [m.sequence for m in reader.messages(["/cost"])]
    assert actual == list(range(1, 1001))


def test_a_chunk_waits_no_longer_than_it_may(tmp_path, messages):
    with BagWriter(tmp_path / "run", WriterOptions(chunk_seconds=0.1)) as writer:
        channel = writer.add_topic("/state", load_schema(LOOP["/state"]))
        empty = writer.bytes_written
        for k in range(21):  # 0.1 s at 5 ms
            assert writer.bytes_written == empty
            writer.write(channel, START + k * PERIOD, START, messages.loop("/state", k))
        written = writer.bytes_written
        assert written > empty
        writer.write(channel, START + PERIOD * 30, START, messages.loop("/state", 30))
        writer.flush_due(START + PERIOD * 49)
        assert writer.bytes_written == written
        writer.flush_due(START + PERIOD * 50)
        assert writer.bytes_written > written


def test_a_clock_that_is_set_back_delays_no_chunk_and_changes_no_time(tmp_path, messages):
    """Before, what was written within the hour was lost by a kill, and logged at one time."""
    options, back = WriterOptions(compression="none", split_bytes=16_000), START - 3600 * 10**9
    times = [START + k * PERIOD for k in range(150)] + [back + k * PERIOD for k in range(5)]
    with BagWriter(tmp_path / "run", options) as writer:
        channel = writer.add_topic("/state", load_schema(LOOP["/state"]))
        for k, now in enumerate(times):
            writer.write(channel, now, now, messages.loop("/state", k))
        before = writer.bytes_written
        writer.flush_due(times[-1])
        assert writer.bytes_written > before
    with BagReader(tmp_path / "run") as reader:
        assert len(reader.files) > 1
        assert [m.log_time for m in reader.messages()] == times


def test_large_messages_do_not_gather_in_memory(tmp_path):
    with BagWriter(tmp_path / "run", WriterOptions(compression="none")) as writer:
        channel = writer.add_topic("/blob", load_schema("std_msgs/msg/UInt8MultiArray"))
        blob = bytes(500_000)
        writer.write_many((START + i, channel, START, blob) for i in range(5))
        assert writer.bytes_written > 5 * len(blob)


def test_an_existing_bag_is_never_overwritten(write_loop):
    folder = write_loop()
    before = (folder / "run_0.mcap").read_bytes()
    with pytest.raises(BagWriteError, match="already holds a bag"):
        BagWriter(folder)
    assert (folder / "run_0.mcap").read_bytes() == before


def test_wrong_options_and_a_closed_bag_are_refused(write_loop, tmp_path):
    with pytest.raises(ConfigError, match="one of none, zstd"):
        WriterOptions(compression="lzma")
    writer = BagWriter(tmp_path / "closed")
    writer.close()
    writer.close()
    with pytest.raises(BagWriteError, match="closed"):
        writer.write(1, 0, 0, b"")


@contextmanager
def file_limit(size):
    """Let no file of this process grow beyond a size: to a writer, a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def fill(folder, limit):
    """Write until the limit is met; return how many messages were accepted, and the error."""
    with BagWriter(folder, WriterOptions(compression="none")) as writer:
        channel = writer.add_topic("/blob", load_schema("std_msgs/msg/UInt8MultiArray"))
        rows = ((10**9 + k, channel, k, k.to_bytes(4, "little") * 25) for k in range(100_000))
        with file_limit(limit), pytest.raises(BagWriteError) as caught:
            writer.write_many(rows)
        assert writer.closed
    return writer.message_count, str(caught.value)


@pytest.mark.parametrize("limit", [100_000, 200_000, 300_000, 999_983])
def test_a_full_disk_is_an_error_and_all_before_it_is_safe(tmp_path, limit):
    folder = tmp_path / "run"
    count, message = fill(folder, limit)
    assert "no space left" in message
    assert "bytes are safe" in message
    with BagReader(folder) as reader:
        numbers = [int.from_bytes(m.data[:4], "little") for m in reader.messages()]
    assert numbers == list(range(count))
    # Lost is what the chunk in progress held. A message takes 131 bytes and 16 in the index.
    assert count * 147 > limit - 65536 * 147 / 131 - 2000


@pytest.mark.parametrize("limit", [100_000, 200_000])
def test_a_full_disk_leaves_a_bag_for_every_reader_if_the_summary_finds_room(tmp_path, limit):
    folder = tmp_path / "run"
    count, _ = fill(folder, limit)
    with AnyReader([folder]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) == count
    with open(folder / "run_0.mcap", "rb") as stream:
        list(StreamReader(stream, validate_crcs=True).records)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BagWriteError, match="cannot create"):
        BagWriter(Path(tmp_path / "file" / "run"))
