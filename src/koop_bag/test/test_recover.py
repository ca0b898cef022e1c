"""Recovery of torn and damaged bags; the result is judged by `rosbags`."""

import itertools
import random

import pytest
import yaml
import zstandard
from rosbags.highlevel import AnyReader

from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError


def test_a_torn_bag_becomes_a_whole_one_with_the_same_messages(write_loop, tmp_path, rng):
    folder = write_loop(n=600)
    with BagReader(folder) as reader:
        expected = list(reader.messages())
    path = folder / "run_0.mcap"
    whole = path.read_bytes()
    (folder / "metadata.yaml").unlink()
    for number in range(3):
        torn = whole[: rng.randrange(len(whole) // 4, len(whole) - 1)]
        path.write_bytes(torn)
        target = tmp_path / f"saved{number}"
        report = recover(folder, target)
        assert path.read_bytes() == torn
        with BagReader(target) as reader:
            assert reader.complete
            saved = list(reader.messages())
        assert saved == expected[: report.messages]
        with AnyReader([target]) as reader:
            assert sum(1 for _ in reader.messages()) == report.messages


def test_only_the_damaged_chunk_is_given_up_and_the_gap_shows(write_loop, tmp_path):
    folder = write_loop(n=600, compression="none")
    path = folder / "run_0.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    report = recover(folder, tmp_path / "saved")
    assert report.damaged_records == 1
    with BagReader(tmp_path / "saved") as reader:
        numbers = [m.sequence for m in reader.messages(["/state"])]
    assert (numbers[0], numbers[-1]) == (1, 600)
    gaps = [b - a for a, b in itertools.pairwise(numbers) if b - a > 1]
    assert len(gaps) == 1
    assert len(numbers) + gaps[0] - 1 == 600


def test_a_topic_whose_schema_is_damaged_is_given_up_and_the_others_are_kept(write_loop, tmp_path):
    path = write_loop(n=50) / "run_0.mcap"
    data = path.read_bytes()
    name = data.index(b"koop_msgs/msg/MeasuredState")
    # the length of the name, before it, now reaches far beyond the record
    path.write_bytes(data[: name - 4] + b"\xff\xff\xff\x7f" + data[name:])
    report = recover(path, tmp_path / "saved")
    assert report.messages == 150
    assert report.damaged_records > 0
    with BagReader(tmp_path / "saved") as reader:
        assert {topic.name for topic in reader.topics} == {"/cost", "/theta", "/ground_truth"}


def test_any_damage_leaves_a_whole_bag_or_an_error(write_loop, tmp_path):
    """As the fuzzer does, on the way that it does not take."""
    data = (write_loop(n=20, compression="none") / "run_0.mcap").read_bytes()
    for seed in range(25):
        path = tmp_path / "damaged.mcap"
        rng = random.Random(seed)
        changed = bytearray(data)
        for _ in range(4):
            changed[rng.randrange(len(changed))] = rng.randrange(256)
        path.write_bytes(changed)
        target = tmp_path / f"saved{seed}"
        try:
            recover(path, target)
        except BagError:
            assert not target.exists()
            continue
        with BagReader(target) as reader:
            assert reader.complete


def test_a_file_of_another_kind_is_refused_before_anything_is_written(tmp_path):
    (tmp_path / "notes.mcap").write_text("not a bag")
    with pytest.raises(BagError, match="not an MCAP file"):
        recover(tmp_path / "notes.mcap", tmp_path / "saved")
    assert not (tmp_path / "saved").exists()


def test_a_bag_of_several_files_is_recovered_as_one(write_loop, tmp_path):
    folder = write_loop(n=1000, split_bytes=16_000)
    report = recover(folder, tmp_path / "saved")
    assert (report.messages, report.torn_bytes) == (4000, 0)
    with BagReader(tmp_path / "saved") as reader:
        assert [m.sequence for m in reader.messages(["/theta"])] == list(range(1, 1001))


def test_qos_and_custom_data_are_kept(tmp_path, messages, write_loop):
    folder = tmp_path / "run"
    with BagWriter(folder) as writer:
        writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        writer.custom_data["operator"] = "me"
    recover(folder, tmp_path / "saved")
    before, after = (
        yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        for path in (folder, tmp_path / "saved")
    )
    assert after["topics_with_message_count"] == before["topics_with_message_count"]
    assert after["custom_data"] == {"operator": "me"}


def test_what_a_killed_recorder_had_kept_is_in_the_recovered_bag(tmp_path, messages):
    writer = BagWriter(tmp_path / "run", ros_distro="rolling")
    writer.keep({"parameters": "a: 1\n"})
    channel = writer.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
    writer.write(channel, 5, 5, messages.loop("/state", 0))
    writer.flush()  # and it is never closed
    assert recover(tmp_path / "run", tmp_path / "saved").messages == 1
    with BagReader(tmp_path / "saved") as reader:
        lines = reader.description
    assert (lines["custom_data"], lines["ros_distro"]) == ({"parameters": "a: 1\n"}, "rolling")
    text = (tmp_path / "saved" / "metadata.yaml").read_text()
    inner = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert inner["custom_data"] == {"parameters": "a: 1\n"}


def test_nothing_to_recover_is_an_error(tmp_path):
    (tmp_path / "run_0.mcap").write_bytes(b"")
    with pytest.raises(BagError, match="nothing to recover"):
        recover(tmp_path, tmp_path / "saved")
    assert not (tmp_path / "saved").exists()


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE", "lone FILE"])
@pytest.mark.parametrize("read", [BagReader, lambda path: recover(path, path.with_name("saved"))])
def test_what_rosbag2_compressed_is_refused_with_the_remedy(write_loop, mode, read):
    folder = write_loop(n=3)
    path = folder / "run_0.mcap"
    if mode == "MESSAGE":
        raw = path.read_bytes()
        path.write_bytes(raw.replace(b"compression_mode: ''", b"compression_mode: message")[:-9])
    else:
        packed = path.with_suffix(".mcap.zstd")
        packed.write_bytes(zstandard.compress(path.read_bytes()))
        path.unlink()
        folder = packed if mode == "lone FILE" else folder
    with pytest.raises(BagError, match=r"^[^\n]*was compressed by rosbag2.*`ros2 bag convert`"):
        read(folder)
    assert not folder.with_name("saved").exists()
