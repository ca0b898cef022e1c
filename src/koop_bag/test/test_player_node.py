"""The player as a process, over real DDS, with nodes that listen and answer."""

import os
import signal
import struct
import time

import pytest
import rclpy
from koop_bag_messages import LOOP, PERIOD, START, padded, step_of
from koop_bag_ros import Player, Recorder, Talker
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from koop_bag.bag.metadata import OfferedQos
from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import MessageSchema, load_schema
from koop_bag.player.node import PlayerNode

pytestmark = pytest.mark.ros


def listen(talker, topics=LOOP):
    return {topic: talker.collect(topic, LOOP[topic]) for topic in topics}


def finish(player, talker):
    """Serve until the player has ended; return its exit code."""
    talker.spin_until(lambda: player.process.poll() is not None, "the player to end")
    return player.process.returncode


def test_all_bytes_arrive_from_the_first_message_on_and_the_clock_tells_their_times(
    write_loop, messages
):
    bag = write_loop(n=2000)
    with Player(bag, pace="fast", clock=True) as player, Talker() as talker:
        actual = listen(talker)
        clock = talker.collect("/clock", "rosgraph_msgs/msg/Clock")
        assert finish(player, talker) == 0, player.output()
        # the player ends when everything has arrived; some still waits in this node's queues
        talker.spin_until(lambda: all(len(f) == 2000 for f in actual.values()), "the rest")
        talker.spin_until(lambda: len(clock) >= 8000, "the clock")
        assert "Traceback" not in player.output()
    for topic, data in actual.items():
        assert data == [padded(messages.loop(topic, k)) for k in range(2000)]
    expected = [START + k * PERIOD + 1000 * i for k in range(2000) for i in range(4)]
    assert clock_times(clock) == expected


def test_a_recording_of_a_playback_is_the_recording(write_loop, tmp_path):
    bag = write_loop(n=200)
    with Recorder(tmp_path / "again") as recorder, Player(bag) as player:
        assert player.end() == 0, player.output()
        recorder.stop()
    with BagReader(bag) as before, BagReader(tmp_path / "again") as after:
        for topic in LOOP:
            first, second = ([m.data for m in b.messages([topic])] for b in (before, after))
            assert second == [padded(data) for data in first]


def test_a_damaged_chunk_ends_the_player_with_one_line(write_loop):
    bag = write_loop(n=2000)
    path = bag / "run_0.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with Player(bag, pace="fast") as player, Talker() as talker:
        listen(talker, ["/state"])
        assert finish(player, talker) == 1
        assert "damaged" in player.output()
        assert "Traceback" not in player.output()


def test_it_starts_later_in_the_bag_keeps_its_pace_and_is_remapped(write_loop):
    bag = write_loop(n=1000)  # 5 s
    remap = ("-r", "/state:=/old/state")
    begin = time.monotonic()
    with Player(bag, *remap, topics="state", start=4.5, pace="'0.2'") as player, Talker() as talker:
        received = talker.collect("/old/state", LOOP["/state"])
        assert finish(player, talker) == 0
        talker.spin_until(lambda: len(received) == 100, "the rest of the states")
        assert time.monotonic() - begin > 2.4  # 99 periods of 25 ms, however slow the start is
        assert "Traceback" not in player.output()
    assert [step_of(data) for data in received] == list(range(900, 1000))


def test_a_signal_ends_it_cleanly(write_loop):
    with Player(write_loop(n=4000), topics="state") as player, Talker() as talker:
        actual = listen(talker, ["/state"])["/state"]
        talker.spin_until(lambda: actual, "the first state")
        player.stop(signal.SIGTERM)
        assert player.process.returncode == 0
        assert "Traceback" not in player.output()
    assert len(actual) < 4000


def clock_times(data):
    stamps = [deserialize_message(item, Clock).clock for item in data]
    return [stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps]


def test_the_offered_qos_is_that_of_the_recorded_publishers(tmp_path, messages):
    profiles = {
        "/map": OfferedQos(durability="transient_local", depth=1),
        "/fast": OfferedQos(reliability="best_effort", deadline=(0, 500_000_000)),
    }
    with BagWriter(tmp_path / "bag") as writer:
        for topic, profile in profiles.items():
            channel = writer.add_topic(topic, load_schema(LOOP["/state"]), [profile])
            writer.write(channel, START, START, messages.loop("/state", 0))
    with Player(tmp_path / "bag") as player, Talker() as talker:
        count = talker.node.count_publishers
        talker.spin_until(lambda: all(map(count, profiles)), "the player")
        actual = {t: talker.node.get_publishers_info_by_topic(t)[0].qos_profile for t in profiles}
        player.stop()
        assert player.process.returncode == 0, player.output()
    assert actual["/map"].durability.name == "TRANSIENT_LOCAL"
    assert actual["/map"].reliability.name == "RELIABLE"
    assert actual["/fast"].reliability.name == "BEST_EFFORT"
    assert actual["/fast"].deadline.nanoseconds == 500_000_000


@pytest.fixture
def configure(capfd):
    """Return a function that configures a player in this process: (result, what it said)."""
    context = rclpy.Context()
    context.init(args=[])
    nodes = []

    def attempt(**parameters):
        chosen = [Parameter(name, value=value) for name, value in parameters.items()]
        nodes.append(PlayerNode(context=context, parameter_overrides=chosen, cli_args=[]))
        capfd.readouterr()
        result = nodes[-1].trigger_configure()
        return result, "".join(capfd.readouterr())

    yield attempt
    for node in nodes:
        node.close()
        node.destroy_node()
    context.shutdown()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"topics": "stat"}, "has no topic /stat; it has /state"),
        ({"start": 99.0}, "has no messages to play there"),
    ],
)
def test_what_cannot_be_played_is_said_and_leaves_nothing_behind(
    write_loop, configure, options, said
):
    bag = write_loop(n=3)
    result, words = configure(bag=str(bag), **options)
    assert result == TransitionCallbackReturn.FAILURE
    assert said in words
    assert len(words.splitlines()) == 1
    held = [os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
    assert str(bag / "run_0.mcap") not in held


def test_messages_of_a_type_that_has_changed_since_are_not_played(tmp_path, configure):
    schema = load_schema(LOOP["/state"])
    other = MessageSchema(schema.name, schema.text, "RIHS01_" + "0" * 64)
    with BagWriter(tmp_path / "bag") as writer:
        channel = writer.add_topic("/state", other)
        writer.write(channel, START, START, struct.pack("<I", 256))
    for options, expected in (({}, "is not played"), ({"topics": "state"}, "error")):
        result, words = configure(bag=str(tmp_path / "bag"), **options)
        assert result == TransitionCallbackReturn.FAILURE
        assert expected in words.lower()
        assert "another version of koop_msgs/msg/MeasuredState" in words


def test_a_player_that_cannot_play_ends_with_one_line(write_loop):
    with Player(write_loop(n=3), bag="/nowhere") as player:
        assert player.end() == 1
        assert "there is no bag /nowhere" in player.output()
        assert "Traceback" not in player.output()
