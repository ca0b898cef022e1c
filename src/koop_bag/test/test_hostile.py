"""Bags made to hurt their reader: each is refused in one line, and soon. Found by fuzzing."""

import struct

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from koop_bag.bag.columns import read_columns
from koop_bag.bag.info import as_text, describe
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError

pytestmark = pytest.mark.timeout(60)  # without its limits a reader takes minutes, or for ever

STATE = "koop_msgs/msg/MeasuredState"
SEPARATOR = "=" * 80
MESSAGE = b"\0\1\0\0" + bytes(36)  # one of them, all zero


def write(path, name, definition, message, topic="/t", note="", qos=""):
    """Write a bag of one message with the `mcap` library."""
    with open(path, "wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        schema = writer.register_schema(name, "ros2msg", definition)
        channel = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": qos})
        writer.add_message(channel, 5, message, 5)
        writer.add_metadata("rosbag2", {"serialized_metadata": note})
        writer.finish()
    return path


def types(*definitions):
    """Join the definitions of p/T0, p/T1, ..."""
    parts = [
        f"MSG: p/T{k}\n{words}\n" if k else words + "\n" for k, words in enumerate(definitions)
    ]
    return f"{SEPARATOR}\n".join(parts).encode()


def read_all(path):
    with BagReader(path) as reader:
        as_text(describe(reader), with_parameters=True)
        for _ in reader.messages():
            pass
        for topic in reader.topics:
            read_columns(reader, topic.name)


def problem(path):
    """Read a bag; return the one line that refuses it."""
    with pytest.raises(BagError) as caught:
        read_all(path)
    words = str(caught.value)
    assert words.isprintable()
    assert len(words) <= 800
    return words


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        (types("p/T0 a"), "endless"),
        (types("T1[] a", "T0[] a"), "endless"),
        (types(*(f"T{k + 1} a" for k in range(2000)), "bool a"), "endless"),
        (
            types(*(f"T{k + 1} a\nT{k + 1} b" for k in range(40)), "bool a"),
            "more than 20000 fields",
        ),
        (types("T1[4000000000] a", "float64[0] a"), "array of 0 elements"),
        (types(f"bool[{'9' * 5000}] a"), "array of 9999"),
    ],
    ids=["circle", "circle of two", "deep", "wide", "nothing very often", "very often"],
)
def test_a_definition_without_end_is_refused(tmp_path, definition, expected):
    assert expected in problem(write(tmp_path / "a.mcap", "p/msg/T0", definition, bytes(40)))


@pytest.mark.parametrize(
    ("note", "expected"),
    [
        ("a: [", "not valid YAML"),
        ("\x1b[31m", "not valid YAML"),
        ("- 1", "not a mapping"),
        ("custom_data: {parameters: 'a: ['}", "not valid YAML"),
        ("custom_data: {parameters: '1'}", "not a mapping"),
        ("[" * 800, "not valid YAML"),
    ],
    ids=range(6),
)
def test_a_description_that_is_none_is_refused(tmp_path, note, expected):
    schema = load_schema(STATE)
    path = write(tmp_path / "a.mcap", STATE, schema.text.encode(), MESSAGE, note=note)
    assert expected in problem(path)


@pytest.mark.parametrize("custom", ["1", "[a]", "{a: {b: 1}}", "{a: &x [*x]}"])
def test_custom_data_that_is_no_text_is_left_out(tmp_path, custom):
    schema = load_schema(STATE)
    note = f"custom_data: {custom}"
    path = write(tmp_path / "a.mcap", STATE, schema.text.encode(), MESSAGE, note=note)
    with BagReader(path) as reader:
        assert reader.custom_data() == {}


def test_names_are_told_in_characters_that_a_terminal_shows(tmp_path):
    name = "\x1b[31m\n" + "x" * 5000
    words = problem(write(tmp_path / "a.mcap", "p/msg/T0", b"T9 a", bytes(40), topic=name))
    assert words == "the bag's message definition lacks p/T9"
    words = problem(write(tmp_path / "b.mcap", "p/msg/T0", b"", b"", topic=name))
    assert "\\x1b[31m xxx" in words


@pytest.mark.parametrize("size", range(4))
def test_a_message_shorter_than_the_mark_of_its_encoding_is_refused(tmp_path, size):
    path = write(tmp_path / "a.mcap", STATE, load_schema(STATE).text.encode(), b"\0\1\0\0"[:size])
    assert "cut short" in problem(path)


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


@pytest.mark.parametrize("opcode", [Opcode.MESSAGE, Opcode.CHUNK])
@pytest.mark.parametrize("size", [0, 1, 15, 21])
def test_a_record_shorter_than_its_head_is_refused(tmp_path, opcode, size):
    path = tmp_path / "a.mcap"
    path.write_bytes(MCAP0_MAGIC + record(opcode, bytes(size)))
    assert problem(path).startswith(f"{path} is damaged")


def chunk_of(data, size):
    builder = RecordBuilder()
    Chunk("zstd", data, 1, 0, 0, size).write(builder)
    return MCAP0_MAGIC + bytes(builder.end())


def test_a_chunk_that_unpacks_to_more_than_it_says_or_than_any_holds_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    packed = zstandard.compress(bytes(300 << 20), 1)
    assert len(packed) < 50_000
    path.write_bytes(chunk_of(packed, 300 << 20))
    assert "claims to unpack to 314572800 bytes" in problem(path)
    path.write_bytes(chunk_of(packed, 100))
    assert "does not decompress" in problem(path)


def test_what_is_whole_is_recovered_from_between_what_is_not(tmp_path):
    schema = load_schema(STATE)
    good = write(tmp_path / "a.mcap", STATE, schema.text.encode() + b"# \xff", MESSAGE, qos="- [")
    builder = RecordBuilder()
    Metadata("rosbag2", {"serialized_metadata": "a: ["}).write(builder)
    short = record(Opcode.MESSAGE, b"1") + record(Opcode.CHANNEL, b"1") + bytes(builder.end())
    raw = good.read_bytes()
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(MCAP0_MAGIC + short + raw[len(MCAP0_MAGIC) :])
    report = recover(bad, tmp_path / "saved")
    assert (report.messages, report.damaged_records) == (1, 3)
    with BagReader(tmp_path / "saved") as reader:
        assert [m.data for m in reader.messages()] == [MESSAGE]
