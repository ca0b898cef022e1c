"""Bags that rosbag2 compressed, message by message or as whole files."""

import numpy as np
import pytest
import yaml
import zstandard
from koop_bag_compressed import METADATA, compress
from koop_bag_messages import LOOP, START
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from koop_bag.bag.columns import read_columns
from koop_bag.bag.diff import compare
from koop_bag.bag.export import export
from koop_bag.bag.info import describe
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_bag.mcap import zstd_file

MODES = ["MESSAGE", "FILE"]


@pytest.fixture
def plain(write_loop):
    """Return a bag of several files, as it is before it is compressed."""
    return write_loop(n=300, split_seconds=0.6)


@pytest.mark.parametrize("mode", MODES)
def test_a_compressed_bag_says_what_the_plain_one_says(plain, tmp_path, mode):
    folder = compress(plain, tmp_path / "packed", mode)
    with BagReader(plain) as first, BagReader(folder) as second:
        assert len(second.files) == len(first.files) > 2
        expected = [(m.topic, m.log_time, m.publish_time, m.data) for m in first.messages()]
        found = [(m.topic, m.log_time, m.publish_time, m.data) for m in second.messages()]
        assert found == expected
        assert all(item.identical for item in compare(first, second))
        for topic in LOOP:
            a, b = (read_columns(bag, topic) for bag in (first, second))
            assert all(np.array_equal(a[k], b[k]) for k in a if k != "sequence")
        told = describe(second)
        assert [topic.steps for topic in told.topics] == [t.steps for t in describe(first).topics]
        assert told.size == sum(path.stat().st_size for path in folder.glob("*.mcap*"))
        assert len(export(second, tmp_path / "tables", "csv")) == len(LOOP)


@pytest.mark.parametrize("mode", MODES)
def test_recovery_unpacks_and_keeps_what_the_bag_says(plain, tmp_path, mode):
    told = yaml.safe_load((plain / METADATA).read_text())
    told["rosbag2_bagfile_information"] |= {"custom_data": {"by": "me"}, "ros_distro": "humble"}
    (plain / METADATA).write_text(yaml.safe_dump(told))
    folder = compress(plain, tmp_path / "packed", mode)
    report = recover(folder, tmp_path / "saved")
    assert (report.messages, report.damaged_records, report.torn_bytes) == (1200, 0, 0)
    saved = yaml.safe_load((tmp_path / "saved" / METADATA).read_text())
    saved = saved["rosbag2_bagfile_information"]
    assert (saved["compression_mode"], saved["compression_format"]) == ("", "")
    assert (saved["custom_data"], saved["ros_distro"]) == ({"by": "me"}, "humble")
    with AnyReader([tmp_path / "saved"]) as reader:
        steps = [reader.deserialize(raw, c.msgtype).step for c, _, raw in reader.messages()]
    assert sorted(steps) == sorted([*range(300)] * 4)
    with BagReader(plain) as first, BagReader(tmp_path / "saved") as second:
        assert all(item.identical for item in compare(first, second))


def test_torn_message_compression_is_known_by_the_messages_alone(plain, tmp_path, messages):
    folder = compress(plain, tmp_path / "packed", "MESSAGE")
    path = folder / "run_0.mcap"
    raw = path.read_bytes()
    # older recorders wrote no description into the file, and a killed one none beside it
    lone = tmp_path / "lone.mcap"
    lone.write_bytes(
        raw.replace(b"compression_mode: MESSAGE", b"compression_mode: NONE   ")[:-9000]
    )
    with BagReader(lone) as reader:
        assert not reader.complete
        found = [m.data for m in reader.messages(["/state"])]
    assert found == [messages.loop("/state", k) for k in range(len(found))]
    assert len(found) > 50


@pytest.mark.parametrize("cut", [1000, 30_000])
def test_a_torn_packed_file_reads_up_to_there(write_loop, tmp_path, cut, messages):
    folder = compress(write_loop(n=4000), tmp_path / "packed", "FILE")
    (path,) = folder.glob("*.zstd")
    path.write_bytes(path.read_bytes()[:-cut])
    with BagReader(folder) as reader:
        assert not reader.complete
        found = [m.data for m in reader.messages(["/state"])]
    assert found == [messages.loop("/state", k) for k in range(len(found))]
    assert 1000 < len(found) <= 4000
    assert recover(folder, tmp_path / "saved").messages >= 4 * len(found) - 4


@pytest.mark.parametrize("whole", ["plain", "packed"])
def test_of_a_file_and_its_packed_twin_the_whole_one_counts(plain, tmp_path, whole):
    # a player of rosbag2 unpacks beside the file; one that was killed leaves half of it there
    folder = compress(plain, tmp_path / "packed", "FILE")
    for path in plain.glob("*.mcap"):
        size = path.stat().st_size if whole == "plain" else 5000
        (folder / path.name).write_bytes(path.read_bytes()[:size])
        if whole == "plain":
            (folder / f"{path.name}.zstd").write_bytes(b"")
    with BagReader(folder) as reader:
        assert reader.complete
        assert reader.message_count == 1200


def test_what_is_compressed_otherwise_is_named_and_not_copied(plain, tmp_path):
    folder = compress(plain, tmp_path / "odd", "MESSAGE", name="lz5")
    for read in (BagReader, lambda path: recover(path, tmp_path / "saved")):
        with pytest.raises(BagError, match="compressed as 'lz5'; known is zstd"):
            read(folder)
    other = tmp_path / "other"
    other.mkdir()
    (other / "bag_0.mcap.lz4").write_bytes(b"")
    for read in (BagReader, lambda path: recover(path, tmp_path / "saved")):
        with pytest.raises(BagError, match=r"bag_0\.mcap\.lz4 is not compressed with zstd"):
            read(other)
    assert not (tmp_path / "saved").exists()


def test_a_damaged_message_is_an_error_and_recovery_gives_up_that_one_only(plain, tmp_path):
    folder = compress(plain, tmp_path / "packed", "MESSAGE")
    path = folder / "run_0.mcap"
    with path.open("rb") as stream:
        (*_, message), *_ = list(make_reader(stream).iter_messages(["/cost"]))[7:]
    data = bytearray(path.read_bytes())
    data[data.index(message.data) + 4] |= 0x08  # a reserved bit: no decoder may take the frame
    path.write_bytes(data)
    with BagReader(folder) as reader, pytest.raises(BagError, match="message does not decompress"):
        list(reader.messages())
    report = recover(folder, tmp_path / "saved")
    assert (report.messages, report.damaged_records) == (1199, 1)


def test_a_message_that_claims_to_be_huge_is_refused(tmp_path):
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = load_schema(LOOP["/state"])
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        channel = writer.register_channel("/state", "cdr", number)
        writer.add_message(channel, START, zstandard.compress(bytes(300 << 20), 1), START)
        writer.finish()
    assert path.stat().st_size < 50_000
    with BagReader(path) as reader, pytest.raises(BagError, match="does not decompress"):
        list(reader.messages())


def test_a_file_that_would_fill_the_disk_is_refused(plain, tmp_path, monkeypatch):
    folder = compress(plain, tmp_path / "packed", "FILE")
    monkeypatch.setattr(zstd_file, "_SHARE", 1e-12)
    with pytest.raises(BagError, match="set TMPDIR to a folder on a larger disk"):
        BagReader(folder)


def test_recovery_keeps_the_encodings_of_topics_that_are_not_of_ros(tmp_path):
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        channel = writer.register_channel("/thing", "json", schema)
        writer.add_message(channel, START, b'{"a": 1}', START)
        writer.finish()
    recover(path, tmp_path / "saved")
    with (tmp_path / "saved" / "saved_0.mcap").open("rb") as stream:
        ((schema, channel, message),) = make_reader(stream).iter_messages()
    assert (schema.encoding, channel.message_encoding, message.data) == (
        "jsonschema",
        "json",
        b'{"a": 1}',
    )
