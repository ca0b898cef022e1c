"""Columns against `rosbags` and `mcap-ros2-support`, which decode message by message."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from koop_bag_messages import LOOP, PERIOD, START
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg

from koop_bag.bag.columns import iter_tables, list_fields, read_columns, read_tables
from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError


@pytest.fixture
def write_bag(tmp_path, messages):
    """Return a function that writes serialized messages of one type as the topic /t."""

    def write(type_name, serialized):
        folder = tmp_path / "bag"
        with BagWriter(folder) as writer:
            channel = writer.add_topic("/t", load_schema(type_name))
            for k, data in enumerate(serialized):
                writer.write(channel, START + k, START + k, data)
        return folder

    return write


def pick(message, field):
    """Return what a field's name means, for a message decoded by another library."""
    value = message
    for part in field.replace("[", ".[").split("."):
        value = value[int(part[1:-1])] if part.startswith("[") else getattr(value, part)
    if hasattr(value, "nanosec"):
        return value.sec * 1_000_000_000 + value.nanosec
    return value


def oracles(folder):
    """Return the messages of /t as decoded by two independent libraries."""
    with AnyReader([folder]) as reader:
        first = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    with open(folder / "bag_0.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        second = [decoded for *_, decoded in reader.iter_decoded_messages()]
    return first, second


def check(folder, fields):
    with BagReader(folder) as reader:
        columns = read_columns(reader, "/t", fields)
    assert list(columns) == list(fields)
    for decoded in oracles(folder):
        for field in fields:
            for row, message in zip(columns[field], decoded, strict=True):
                expected = pick(message, field)
                assert np.array_equal(row, expected), (field, row, expected)


def frame(rng):
    return "f" * rng.randrange(12)


@pytest.mark.parametrize("topic", LOOP)
def test_the_loops_messages_with_frame_ids_and_model_ids_of_any_length(
    write_bag, messages, topic, rng
):
    data = [messages.loop(topic, k, frame(rng), "m" * rng.randrange(15)) for k in range(150)]
    fields = {
        "/state": ["step", "x", "x[1]", "header.stamp", "header.stamp.nanosec", "header.frame_id"],
        "/cost": ["model_id", "source", "y_out", "r", "step"],
        "/theta": [
            "holding",
            "saturated",
            "epsilon",
            "cost_rise_filtered",
            "theta",
            "confidence",
            "header.stamp.sec",
        ],
        "/ground_truth": ["epsilon0", "theta_applied", "x", "step"],
    }
    check(write_bag(LOOP[topic], data), fields[topic])


def test_joint_states_with_names_of_any_length(write_bag, messages, rng):
    kind = "sensor_msgs/msg/JointState"
    data = []
    for k in range(200):
        made = messages.make(
            kind,
            header=messages.header(k, frame(rng)),
            name=["j" * rng.randrange(9) for _ in range(3)],
            position=np.array([k, k + 0.5, k - 0.25]),
            velocity=np.array([1.0 / (k + 1)] * 2),
            effort=np.array([]),
        )
        data.append(messages.serialize(kind, made))
    fields = ["position[0]", "position", "velocity", "effort", "name[2]", "header.stamp"]
    check(write_bag(kind, data), fields)


def test_multi_arrays_with_layouts_of_any_depth(write_bag, messages, rng):
    kind = "std_msgs/msg/Float64MultiArray"
    data = []
    for k in range(200):
        dimensions = [
            messages.make("std_msgs/msg/MultiArrayDimension", label="d" * i, size=k, stride=i)
            for i in range(1, 1 + rng.randrange(1, 4))
        ]
        layout = messages.make("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=k)
        made = messages.make(kind, layout=layout, data=np.array([k * 0.1, -k, 3.0]))
        data.append(messages.serialize(kind, made))
    fields = ["data", "data[2]", "layout.data_offset", "layout.dim[0].label", "layout.dim[0].size"]
    check(write_bag(kind, data), fields)


def diagnostics(messages, rng, k, count):
    def values():
        key_value = "diagnostic_msgs/msg/KeyValue"
        return [
            messages.make(key_value, key="k" * rng.randrange(5), value=str(k) * i)
            for i in range(1, 4)
        ]

    status = [
        messages.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=(k + i) % 4,
            name="n" * rng.randrange(30),
            message="µ" * rng.randrange(9),
            hardware_id="",
            values=values(),
        )
        for i in range(count)
    ]
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    made = messages.make(kind, header=messages.header(k), status=status)
    return messages.serialize(kind, made)


def test_diagnostics_where_every_message_has_a_layout_of_its_own(write_bag, messages, rng):
    data = [diagnostics(messages, rng, k, rng.randrange(2, 5)) for k in range(400)]
    fields = [f"status[{i}].{name}" for i in (1, 0) for name in ("name", "message")]
    folder = write_bag("diagnostic_msgs/msg/DiagnosticArray", data)
    check(folder, [*fields, "status[1].values[2].value", "header.stamp"])
    with BagReader(folder) as reader:
        level = read_columns(reader, "/t", ["status[1].level"])["status[1].level"]
    decoded, _ = oracles(folder)
    assert level.tolist() == [message.status[1].level for message in decoded]


def test_every_alignment_of_every_primitive(tmp_path, messages, rng, monkeypatch):
    """Fields in random order after strings of random length meet every offset there is."""
    primitives = "bool byte char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float32 float64"
    for round_ in range(8):
        kinds = primitives.split() * 2
        rng.shuffle(kinds)
        lines, suffixes = [], ["", "[3]", "[]", "[<=4]"]
        for i, kind in enumerate(kinds):
            if i % 5 == 0:
                lines.append(f"string s{i}")
            lines.append(f"{kind}{suffixes[rng.randrange(4)]} f{i}")
        text = "\n".join(["# alignments", "int32 LIMIT=7", *lines, ""])
        share = tmp_path / f"p{round_}" / "share" / "odd_msgs" / "msg"
        share.mkdir(parents=True)
        (share / f"Odd{round_}.msg").write_text(text)
        name = f"odd_msgs/msg/Odd{round_}"
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / f"p{round_}"))
        schema = load_schema(name)
        messages.store.register(get_types_from_msg(text, name))
        folder = tmp_path / f"bag{round_}" / "bag"
        with BagWriter(folder) as writer:
            channel = writer.add_topic("/t", schema)
            lengths = {line: rng.randrange(5) for line in lines}
            for k in range(40):
                fields = {}
                for line in lines:
                    kind, field = line.split()
                    fields[field] = value_of(kind, lengths[line], rng)
                data = messages.serialize(name, messages.make(name, **fields))
                writer.write(channel, START + k, START, data)
        with BagReader(folder) as reader:
            columns = read_columns(reader, "/t")
            assert list(columns) == [line.split()[1] for line in lines]
        with AnyReader([folder]) as reader:
            decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
        for field, column in columns.items():
            for row, message in zip(column, decoded, strict=True):
                expected = getattr(message, field)
                assert np.array_equal(row, expected), (text, field, row, expected)


def value_of(kind, length, rng):
    base, bracket, _ = kind.partition("[")
    if base == "string":
        return "s" * rng.randrange(9)
    numpy_type = {"byte": "uint8", "char": "uint8"}.get(base, base)
    count = {"": 1, "[3]": 3}.get(kind[len(base) :], min(length, 4))
    values = np.array([rng.randrange(100) for _ in range(count)]).astype(numpy_type)
    return values if bracket else values[0].item()


def test_columns_come_in_batches_that_add_up(write_loop, monkeypatch):
    monkeypatch.setattr("koop_bag.bag.columns.BATCH_BYTES", 50_000)
    with BagReader(write_loop(n=3000)) as reader:
        whole = read_columns(reader, "/ground_truth", ["step", "x", "log_time"])
        tables = {"/ground_truth": ["step", "x", "log_time"]}
        parts = [part for _, part in iter_tables(reader, tables)]
    assert len(parts) > 10
    for name, column in whole.items():
        assert np.array_equal(np.concatenate([part[name] for part in parts]), column)
    assert whole["log_time"].tolist() == [START + k * PERIOD + 3000 for k in range(3000)]


def test_several_topics_are_read_in_one_pass(write_loop):
    with BagReader(write_loop(n=500, split_bytes=8_000)) as reader:
        assert len(reader.files) > 2
        tables = read_tables(reader, {"/theta": ["step", "theta"], "/cost": ["r", "sequence"]})
    assert np.array_equal(tables["/theta"]["theta"], -np.arange(500)[:, None] / 7)
    assert np.array_equal(tables["/cost"]["r"], np.arange(500) * 1.5)
    assert np.array_equal(tables["/cost"]["sequence"], np.arange(1, 501))


def test_files_of_one_bag_may_number_their_channels_differently(tmp_path, messages):
    for number, order in enumerate((["/state", "/ground_truth"], ["/ground_truth", "/state"])):
        with open(tmp_path / f"bag_{number}.mcap", "wb") as stream:
            writer = Writer(stream)
            writer.start("ros2")
            for topic in order:
                schema = load_schema(LOOP[topic])
                reference = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
                channel = writer.register_channel(topic, "cdr", reference)
                for k in range(5):
                    now = START + 5 * number + k
                    data = messages.loop(topic, 5 * number + k)
                    writer.add_message(channel, now, data, now)
            writer.finish()
    with BagReader(tmp_path) as reader:
        tables = read_tables(
            reader, {"/state": ["step", "x"], "/ground_truth": ["step", "epsilon0"]}
        )
    assert tables["/state"]["x"][:, 0].tolist() == [k + 0.25 for k in range(10)]
    assert tables["/ground_truth"]["epsilon0"].tolist() == [k / 11 for k in range(10)]


def test_an_element_beyond_the_end_of_an_array_is_nan(write_bag, messages):
    kind = "sensor_msgs/msg/JointState"
    empty = np.array([])
    data = []
    for k in range(6):
        made = messages.make(
            kind,
            header=messages.header(k),
            name=[],
            position=np.arange(k % 3, dtype=float),
            velocity=empty,
            effort=empty,
        )
        data.append(messages.serialize(kind, made))
    with BagReader(write_bag(kind, data)) as reader:
        second = read_columns(reader, "/t", ["position[1]"])["position[1]"]
        assert [None if math.isnan(v) else v for v in second] == [None, None, 1.0] * 2
        with pytest.raises(BagError, match=r"elements in different messages: choose elements"):
            read_columns(reader, "/t", ["position"])


def test_fields_that_are_not_there_are_answered_with_those_that_are(write_loop):
    with BagReader(write_loop(n=3)) as reader:
        reference = ["header.stamp", "header.frame_id", "step", "lockstep", "x"]
        assert list_fields(reader, "/state") == reference
        with pytest.raises(BagError, match=r"no field 'y'; it has header.stamp.*step, lockstep, x"):
            read_columns(reader, "/state", ["y"])
        with pytest.raises(BagError, match=r"'header' is a message of its own.*header.stamp"):
            read_columns(reader, "/state", ["header"])
        with pytest.raises(BagError, match="not a field"):
            read_columns(reader, "/state", ["x[-1]"])
        with pytest.raises(BagError, match="no field"):
            read_columns(reader, "/state", ["step[0]"])
        with pytest.raises(BagError, match="no topic /stat;"):
            read_columns(reader, "/stat", ["step"])


@pytest.mark.parametrize("kind", [str, Path])
def test_the_path_of_a_bag_does_in_place_of_its_reader(write_bag, messages, tmp_path, kind):
    """Failed before: AttributeError, a str has no 'topics'."""
    folder = write_bag(LOOP["/state"], [messages.loop("/state", k) for k in range(3)])
    assert read_columns(kind(folder), "/t", ["step"])["step"].tolist() == [0, 1, 2]
    with pytest.raises(BagError, match="there is no bag"):
        read_columns(kind(tmp_path / "absent"), "/t")


def test_a_message_shorter_than_its_type_is_an_error(write_bag, messages):
    data = messages.loop("/state", 1)
    for cut in (data[:30], data[:-9], data[:12]):
        folder = write_bag(LOOP["/state"], [cut])
        with BagReader(folder) as reader, pytest.raises(BagError, match=r"topic /t: .*cut short"):
            read_columns(reader, "/t", ["x"])
        for path in folder.iterdir():
            path.unlink()


def test_a_field_of_the_message_may_be_named_like_a_stored_one(tmp_path, monkeypatch):
    share = tmp_path / "share" / "own_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Numbered.msg").write_text("uint32 sequence\n")
    with BagWriter(tmp_path / "bag") as writer:
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
        channel = writer.add_topic("/t", load_schema("own_msgs/msg/Numbered"))
        writer.write(channel, START, START, b"\0\1\0\0\x2a\0\0\0")
    with BagReader(tmp_path / "bag") as reader:
        assert list_fields(reader, "/t") == [".sequence"]
        columns = read_columns(reader, "/t", [".sequence", "sequence"])
    assert (columns[".sequence"][0], columns["sequence"][0]) == (42, 1)


MEASURE = """
import resource, sys
from koop_bag.bag.columns import iter_tables
from koop_bag.bag.reader import BagReader
total = 0.0
with BagReader(sys.argv[1]) as reader:
    for _, columns in iter_tables(reader, {"/state": ["step", "x"]}):
        total += float(columns["x"].sum())
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak(folder):
    """Return the peak memory of reading a bag in batches, in a process of its own [MiB]."""
    command = [sys.executable, "-c", MEASURE, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout)


def test_memory_does_not_grow_with_the_bag(tmp_path, messages):
    folders = []
    block = [messages.loop("/state", k, frame_id="x" * 900) for k in range(1000)]  # 1 MB
    for size in (4, 50):
        with BagWriter(tmp_path / f"bag{size}") as writer:
            channel = writer.add_topic("/state", load_schema(LOOP["/state"]))
            for part in range(size):
                begin = START + part * len(block) * PERIOD
                rows = ((begin + k * PERIOD, channel, START, data) for k, data in enumerate(block))
                writer.write_many(rows)
        folders.append(tmp_path / f"bag{size}")
    small, large = map(peak, folders)
    # 46 MB more of bag; a batch is at most 8 MB, held twice while it is put together
    assert large - small < 24.0, (small, large)
