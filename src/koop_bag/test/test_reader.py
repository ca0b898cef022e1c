"""Bags that are foreign, torn or absent, and bags written by others."""

from dataclasses import replace

import pytest
from koop_bag_messages import LOOP, PERIOD, START
from mcap.records import Statistics
from mcap.writer import CompressionType, IndexType, Writer

from koop_bag.bag.columns import read_columns
from koop_bag.bag.info import as_text, describe
from koop_bag.bag.metadata import OfferedQos, parse_qos
from koop_bag.bag.reader import BagReader
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError


def test_messages_come_back_as_they_were_written(write_loop, messages):
    with BagReader(write_loop(n=200)) as reader:
        assert reader.complete
        assert {topic.name: topic.type_name for topic in reader.topics} == LOOP
        assert [topic.count for topic in reader.topics] == [200] * 4
        assert reader.message_count == 800
        assert reader.start_time == START
        assert reader.duration == pytest.approx(199 * 0.005 + 3e-6, abs=1e-12)
        actual = list(reader.messages())
    assert [m.topic for m in actual[:4]] == list(LOOP)
    for index, message in enumerate(actual):
        k, i = divmod(index, 4)
        assert message.data == messages.loop(message.topic, k)
        assert message.log_time == START + k * PERIOD + 1000 * i
        assert message.publish_time == message.log_time - 500


def test_topics_and_a_start_can_be_chosen(write_loop):
    with BagReader(write_loop(n=200)) as reader:
        actual = list(reader.messages(["/cost", "/ground_truth"], START + 190 * PERIOD))
        assert len(actual) == 20
        assert {m.topic for m in actual} == {"/cost", "/ground_truth"}
        with pytest.raises(BagError, match=r"no topic /stat; it has /state, /cost"):
            list(reader.messages(["/stat"]))


def test_a_file_alone_and_the_folder_of_a_run_are_bags_too(write_loop, tmp_path):
    folder = write_loop("bag", n=10)
    for path in (folder, folder / "bag_0.mcap", tmp_path):
        with BagReader(path) as reader:
            assert reader.message_count == 40


def write_foreign(path, messages, count, **options):
    """Write a file of states with the writer of the mcap project."""
    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        writer.start("ros2")
        schema = load_schema(LOOP["/state"])
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        channel = writer.register_channel("/state", "cdr", number)
        for k in range(count):
            writer.add_message(channel, START + k, messages.loop("/state", k), START, k)
        writer.finish()


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_the_mcap_library_are_read(tmp_path, messages, compression, chunked):
    path = tmp_path / "foreign.mcap"
    options = {"chunk_size": 4096, "compression": compression, "use_chunking": chunked}
    write_foreign(path, messages, 300, **options)
    with BagReader(path) as reader:
        assert reader.message_count == 300
        assert [m.sequence for m in reader.messages()] == list(range(300))
        columns = read_columns(reader, "/state", ["step", "x"])
    assert columns["step"].tolist() == list(range(300))
    assert columns["x"][299].tolist() == [299.25, -299.5]


@pytest.mark.parametrize("lacking", ["counts", "repeat_schemas", "repeat_channels"])
def test_what_the_summary_leaves_out_is_read_from_the_file(
    tmp_path, messages, monkeypatch, lacking
):
    """A writer may: https://mcap.dev/spec, sections "Statistics" and "Summary Section"."""
    path, write = tmp_path / "foreign.mcap", Statistics.write
    if lacking == "counts":
        bare = {"channel_message_counts": {}}
        monkeypatch.setattr(
            Statistics, "write", lambda self, out: write(replace(self, **bare), out)
        )
    write_foreign(path, messages, 3, **({} if lacking == "counts" else {lacking: False}))
    with BagReader(path) as reader:
        assert (reader.message_count, reader.start_time, reader.end_time) == (3, START, START + 2)
        assert reader.topic("/state").type_name == LOOP["/state"]
        assert read_columns(reader, "/state", ["step"])["step"].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("encoding", "language", "definition"),
    [
        ("cdr", "ros2idl", b"module p { module msg { struct T { double x; }; }; };"),
        ("cdr", "ros2msg", b"Missing x"),
        ("json", "jsonschema", b"{}"),
    ],
)
def test_a_topic_that_cannot_be_decoded_leaves_the_others_readable(
    tmp_path, messages, encoding, language, definition
):
    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = load_schema(LOOP["/state"])
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        state = writer.register_channel("/state", "cdr", number)
        number = writer.register_schema("p/msg/T", language, definition)
        other = writer.register_channel("/other", encoding, number)
        for k in range(5):
            writer.add_message(state, START + k * PERIOD, messages.loop("/state", k), START, k)
            writer.add_message(other, START + 2 * k * PERIOD, b"{}", START, k)
        writer.finish()
    with BagReader(path) as reader:
        lines = as_text(describe(reader)).splitlines()
        assert lines[-2].split() == ["/state", "5", "200.0", "0", LOOP["/state"]]
        assert lines[-1].split() == ["/other", "5", "100.0", "-", "p/msg/T"]
        with pytest.raises(BagError, match=r"lacks p/Missing|has no ROS 2 message definition"):
            read_columns(reader, "/other")
        sent = read_columns(reader, "/other", ["sequence", "log_time"])
    assert sent["sequence"].tolist() == list(range(5))
    assert sent["log_time"].tolist() == [START + 2 * k * PERIOD for k in range(5)]


def test_equal_times_keep_the_order_of_recording(tmp_path, messages):
    path = tmp_path / "same.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = load_schema(LOOP["/state"])
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        a, b = (writer.register_channel(name, "cdr", number) for name in ("/b", "/a"))
        for k in range(50):
            writer.add_message(a if k % 2 else b, START, messages.loop("/state", k), START, k)
        writer.finish()
    with BagReader(path) as reader:
        assert [m.sequence for m in reader.messages()] == list(range(50))


def test_a_torn_bag_is_read_up_to_its_last_complete_chunk_wherever_it_is_torn(write_loop, rng):
    folder = write_loop(n=600)
    path = folder / "run_0.mcap"
    whole = path.read_bytes()
    with BagReader(folder) as reader:
        expected = list(reader.messages())
    (folder / "metadata.yaml").unlink()
    counts = []
    for size in sorted(rng.randrange(9, len(whole)) for _ in range(40)):
        path.write_bytes(whole[:size])
        with BagReader(folder) as reader:
            assert not reader.complete
            actual = list(reader.messages())
            assert actual == expected[: len(actual)]
            assert reader.message_count == len(actual)
        counts.append(len(actual))
    assert counts == sorted(counts)
    assert counts[-1] > 2000


@pytest.mark.parametrize("indexes", [IndexType.ALL, IndexType.NONE])
def test_a_seldom_topic_is_found_wherever_the_file_is_torn(tmp_path, messages, indexes):
    """By the indexes behind the chunks, of which a torn file has only some."""
    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream, 1024, CompressionType.NONE, index_types=indexes)
        writer.start("ros2")
        schema = load_schema(LOOP["/state"])
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        often, seldom = (writer.register_channel(name, "cdr", number) for name in ("/a", "/b"))
        for k in range(160):
            channel = often if k % 40 else seldom
            writer.add_message(channel, START, messages.loop("/state", k), START, k)
        writer.finish()
    whole = path.read_bytes()
    for size in (*range(9, len(whole), 29), len(whole)):  # an index has at least 31 bytes
        path.write_bytes(whole[:size])
        with BagReader(path) as reader:
            expected = [m for m in reader.messages() if m.topic == "/b"]
            assert not expected or list(reader.messages(["/b"])) == expected
    assert [m.sequence for m in expected] == [0, 40, 80, 120]
    path.write_bytes(whole.replace(messages.loop("/state", 60), messages.loop("/state", 61)))
    with BagReader(path) as reader:
        if indexes is IndexType.ALL:  # a damaged chunk without it is not even read
            assert list(reader.messages(["/b"])) == expected
        with pytest.raises(BagError, match="damaged"):
            list(reader.messages())


def test_a_file_that_lost_power_left_empty_hides_no_other(write_loop):
    folder = write_loop(n=700, split_bytes=50_000)
    *others, last = sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.split("_")[-1]))
    with BagReader(folder) as reader:
        expected = list(reader.messages())
    with BagReader(last) as reader:
        lost = reader.message_count
    last.write_bytes(b"")
    with BagReader(folder) as reader:
        assert not reader.complete
        assert list(reader.messages()) == expected[:-lost]
    assert others
    assert lost


def test_a_damaged_chunk_is_reported_and_never_decoded(write_loop):
    folder = write_loop(n=600, compression="none")
    path = folder / "run_0.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with BagReader(folder) as reader, pytest.raises(BagError, match=r"damaged.*koop bag recover"):
        list(reader.messages())


FOREIGN = {
    "empty": (b"", "is empty"),
    "text": (b"stamp,x,y\n1,2,3\n", "not an MCAP file"),
    "sqlite": (b"SQLite format 3\0" + bytes(100), "ros2 bag convert"),
    "one byte": (b"\x89", "not an MCAP file"),
}


@pytest.mark.parametrize(("content", "expected"), FOREIGN.values(), ids=FOREIGN)
def test_a_file_that_is_no_bag_says_what_it_is(tmp_path, content, expected):
    path = tmp_path / "run_0.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match=expected):
        BagReader(path)


def test_absent_bags_and_folders_without_one_are_named(tmp_path):
    with pytest.raises(BagError, match="there is no bag"):
        BagReader(tmp_path / "absent")
    with pytest.raises(BagError, match=r"contains no \.mcap file"):
        BagReader(tmp_path)
    (tmp_path / "bag_0.db3").write_bytes(b"SQLite format 3")
    with pytest.raises(BagError, match="ros2 bag convert"):
        BagReader(tmp_path)


def test_an_empty_bag_is_a_bag(write_loop):
    with BagReader(write_loop(n=0)) as reader:
        assert (reader.message_count, reader.duration) == (0, 0.0)
        assert list(reader.messages()) == []
        assert read_columns(reader, "/state", ["step"])["step"].size == 0


def test_a_damaged_index_is_an_error_of_the_bag_and_nothing_else(tmp_path):
    """Offsets and lengths that fuzzing made up once ended in MemoryError or OverflowError."""
    from koop_bag.mcap.file_reader import McapFile, Place

    file = tmp_path / "a.mcap"
    file.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    opened = McapFile(file)
    for start, length in ((0, 2**62), (2**63, 8), (50, -9), (100, 9)):
        with pytest.raises(BagError, match="is damaged"):
            opened.content(Place(0, start, length))
    opened.close()


def test_qos_of_older_recorders_is_read():
    """Before version 9 rosbag2 wrote the numbers of rmw/types.h, and Foxy its DDS' 'for ever'."""
    (actual,) = parse_qos(
        "- {history: 1, depth: 5, reliability: 2, durability: 1, liveliness: 1,"
        " deadline: {sec: 2147483647, nsec: 4294967295}, lifespan: {sec: 1, nsec: 5},"
        " liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}}"
    )
    assert actual == OfferedQos(
        depth=5, reliability="best_effort", durability="transient_local", lifespan=(1, 5)
    )
    with pytest.raises(BagError, match="QoS"):
        parse_qos("- {history: 99}")
