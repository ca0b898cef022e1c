"""`koop bag` on real bags, judged by `rosbags` and counting by hand."""

import argparse
import json
import subprocess
import sys

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


def test_files_of_several_bags_are_not_read_as_one(write_loop, koop, tmp_path):
    whole = write_loop(n=20)
    (file,) = whole.glob("*.mcap")
    several = tmp_path / "several"
    several.mkdir()
    names = ["monday_0.mcap", "monday_1.mcap", "tuesday.mcap"]
    for name in names[:2]:
        (several / name).write_bytes(file.read_bytes())
    assert koop("info", several)[0] == 0
    (several / names[2]).write_bytes(file.read_bytes())
    for command in ("info", "recover"):
        code, _, errors = koop(command, several)
        assert code == 2
        assert f"{several} holds monday_0.mcap, tuesday.mcap, monday_1.mcap: name one" in errors
    assert koop("info", several / "tuesday.mcap")[0] == 0
    metadata = yaml.safe_load((whole / "metadata.yaml").read_text())
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (several / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    assert koop("info", several)[0] == 0


def test_info_says_what_is_there_and_what_is_lost(write_loop, koop, messages, tmp_path):
    folder = tmp_path / "run"
    with BagWriter(folder) as writer:
        channels = {t: writer.add_topic(t, load_schema(kind)) for t, kind in LOOP.items()}
        for k in [*range(10), *range(13, 21), 20]:
            for topic, channel in channels.items():
                if topic != "/ground_truth" or k < 10:
                    now = START + k * PERIOD
                    writer.write(channel, now, now, messages.loop(topic, k, model_id="abc"))
        writer.custom_data["parameters"] = (
            "/esc:\n  ros__parameters:\n    gain: 2.5\n    since: 2026-01-02\n"
        )
    code, text, _ = koop("info", folder, "--parameters")
    assert code == 0
    assert "complete" in text
    assert "gain: 2.5" in text
    _, text, _ = koop("info", folder, "--json")
    actual = json.loads(text)
    assert actual["model_ids"] == ["abc"]
    assert actual["parameters"] == {"/esc": {"gain": 2.5, "since": "2026-01-02"}}
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
            output, _ = player.communicate(timeout=240)
        finally:
            player.kill()
    assert player.returncode == 0, output
    assert received == [messages.loop("/state", k) for k in range(20)]
