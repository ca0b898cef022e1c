"""`koop bag` on real bags, judged by `rosbags` and counting by hand."""

import argparse
import csv
import json
import subprocess
import sys

import numpy as np
import pytest
import yaml
from koop_bag_messages import LOOP, PERIOD, START
from koop_bag_ros import Talker
from rosbags.highlevel import AnyReader

from koop_bag import cli
from koop_bag.bag.losses import early_ends
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.player.config import PlayerConfig
from koop_bag.recorder.config import RecorderConfig
from koop_core.config.parameter import ConfigError
from koop_core.errors import KoopError


@pytest.fixture
def koop(capsys):
    """Return a function that runs `koop bag ...` here: (exit code, output, errors)."""
    parser = argparse.ArgumentParser()
    cli.register(parser.add_subparsers(dest="command"))

    def run(*arguments):
        args = parser.parse_args(["bag", *map(str, arguments)])
        try:
            code = args.func(args)
        except KoopError as error:  # which the command line prints
            print(error, file=sys.stderr)
            code = 2
        return (code, *capsys.readouterr())

    return run


# -- info -------------------------------------------------------------------------------------


def test_info_says_what_is_there_and_what_is_lost(write_loop, koop, messages, tmp_path):
    folder = tmp_path / "run"
    with BagWriter(folder) as writer:
        channels = {t: writer.add_topic(t, load_schema(kind)) for t, kind in LOOP.items()}
        for k in [*range(10), *range(13, 21), 20]:
            for topic, channel in channels.items():
                if topic != "/ground_truth" or k < 10:
                    now = START + k * PERIOD
                    writer.write(channel, now, now, messages.loop(topic, k, model_id="abc"))
        writer.custom_data["parameters"] = "/esc:\n  ros__parameters:\n    gain: 2.5\n"
    code, text, _ = koop("info", folder, "--parameters")
    assert code == 0
    assert "complete" in text
    assert "gain: 2.5" in text
    _, text, _ = koop("info", folder, "--json")
    actual = json.loads(text)
    assert actual["model_ids"] == ["abc"]
    assert actual["parameters"] == {"/esc": {"gain": 2.5}}
    assert actual["messages"] == 3 * 19 + 10
    topics = {topic["name"]: topic for topic in actual["topics"]}
    assert topics["/state"]["steps"] | {"count": 0} == {
        "count": 0,
        "lost": 3,
        "duplicates": 1,
        "backward": 0,
        "jumps": 0,
        "inactive": 0,
        "first": 0,
        "last": 20,
    }
    assert topics["/ground_truth"]["rate"] == pytest.approx(200.0)
    _, text, _ = koop("info", folder)
    assert "ends at step 9, 11 before the loop" in text


def test_info_of_a_torn_bag_tells_the_remedy(write_loop, koop):
    path = write_loop(n=500) / "run_0.mcap"
    path.write_bytes(path.read_bytes()[:-3000])
    code, text, _ = koop("info", path.parent)
    assert code == 0
    assert "torn: `koop bag recover`" in text
    code, text, _ = koop("recover", path.parent)
    assert code == 0
    assert "0 damaged records" in text
    with AnyReader([path.parent.with_name("run_recovered")]) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) > 1500


def test_a_topic_that_ends_early_is_no_gap_but_still_lacks_something():
    assert early_ends({"/a/state": 99, "/a/ground_truth": 90, "/b/state": 5, "/a/theta": 98}) == {
        "/a/ground_truth": 9
    }
    assert early_ends({}) == {}


# -- export -----------------------------------------------------------------------------------


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_number_and_text_is_exported(write_loop, koop, tmp_path):
    folder = write_loop(n=300)
    code, text, _ = koop("export", folder, "-o", tmp_path / "out")
    assert code == 0
    assert len(text.splitlines()) == 4
    with AnyReader([folder]) as reader:
        for connection in reader.connections:
            rows = read_csv(tmp_path / "out" / f"{connection.topic[1:]}.csv")
            actual = reader.messages([connection])
            for row, (_, time, raw) in zip(rows, actual, strict=True):
                message = reader.deserialize(raw, connection.msgtype)
                assert int(row["log_time"]) == time
                stamp = message.header.stamp
                assert int(row["header.stamp"]) == stamp.sec * 10**9 + stamp.nanosec
                for name, value in vars(message).items():
                    if isinstance(value, np.ndarray):
                        exported = [float(row[f"{name}[{i}]"]) for i in range(value.size)]
                        assert exported == value.tolist()
                    elif name.islower() and name not in ("header", "__msgtype__"):  # no constant
                        assert row[name] == str(value), name


def test_elements_that_a_message_lacks_are_empty(tmp_path, messages, koop):
    kind = "sensor_msgs/msg/JointState"
    lengths = [2, 0, 3]
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/rig/joints", load_schema(kind))
        for k, length in enumerate(lengths):
            made = messages.make(
                kind,
                header=messages.header(k),
                name=[f"j{i}" for i in range(length)],
                position=np.arange(length, dtype=float),
                velocity=np.array([]),
                effort=np.array([]),
            )
            writer.write(channel, START + k, START, messages.serialize(kind, made))
    koop("export", tmp_path / "bag", "-o", tmp_path)
    rows = read_csv(tmp_path / "rig.joints.csv")
    assert [row["name[0]"] for row in rows] == ["j0", "", "j0"]
    assert [row["name[2]"] for row in rows] == ["", "", "j2"]
    assert float(rows[2]["position[2]"]) == 2.0
    assert "velocity[0]" not in rows[0]
    assert "position[3]" not in rows[0]


MEASURE = """
import sys
from pathlib import Path
from koop_bag.bag.export import export
from koop_bag.bag.reader import BagReader
with BagReader(sys.argv[1]) as reader:
    export(reader, Path(sys.argv[2]))
print([line for line in open("/proc/self/status") if "VmHWM" in line][0].split()[1])
"""


def test_the_memory_of_an_export_does_not_grow_with_the_bag(tmp_path, messages):
    kind = "std_msgs/msg/Float64MultiArray"
    layout = messages.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    made = messages.make(kind, layout=layout, data=np.arange(400.0))
    data = messages.serialize(kind, made)
    peaks = []
    for size in (3_000, 20_000):  # 10 and 64 MB
        with BagWriter(tmp_path / f"bag{size}") as writer:
            channel = writer.add_topic("/wide", load_schema(kind))
            writer.write_many((START + k * PERIOD, channel, START, data) for k in range(size))
        command = [sys.executable, "-c", MEASURE, tmp_path / f"bag{size}", tmp_path / str(size)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        peaks.append(float(done.stdout) / 1024)
    # a batch is 8 MB, and held as cells
    assert peaks[1] - peaks[0] < 40.0, peaks


# -- play -------------------------------------------------------------------------------------


def test_the_options_of_play_are_parameters_of_the_player():
    parser = argparse.ArgumentParser()
    cli.register(parser.add_subparsers(dest="command"))
    words = ["b'ag", "--pace", "2", "--clock", "--topics", "7", "--start", "1.5"]
    arguments = cli.player_arguments(parser.parse_args(["bag", "play", *words]))
    assert arguments[0] == "--ros-args"
    options = dict(word.split(":=", 1) for word in arguments if word != "-p" and ":=" in word)
    values = {name: yaml.safe_load(text) for name, text in options.items()}
    assert values == {"bag": "b'ag", "pace": "2", "topics": "7", "clock": True, "start": 1.5}
    assert PlayerConfig(**values).speed == 2.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"keep_size": -1.0}, "keep_size"),
        ({"topics": "state a:b"}, "'a:b' is neither a name nor name:pkg/msg/Type"),
        ({"queue": 1}, "queue"),
    ],
)
def test_settings_of_the_recorder_that_cannot_be_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        RecorderConfig(**options)


# `koop bag`, without the package that has `koop`
PROGRAM = """
import argparse, sys
from koop_bag import cli
parser = argparse.ArgumentParser()
cli.register(parser.add_subparsers(dest="command"))
args = parser.parse_args(["bag", *sys.argv[1:]])
sys.exit(args.func(args))
"""


@pytest.mark.ros
def test_play_publishes_a_bag(write_loop, messages):
    bag = write_loop(n=20)
    words = [sys.executable, "-c", PROGRAM, "play", str(bag), "--pace", "fast", "--topics", "state"]
    with (
        Talker() as talker,
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as player,
    ):
        received = talker.collect("/state", LOOP["/state"])
        try:
            talker.spin_until(lambda: len(received) == 20, "all messages")
            output, _ = player.communicate(timeout=30)
        finally:
            player.kill()
    assert player.returncode == 0, output
    assert received == [messages.loop("/state", k) for k in range(20)]
