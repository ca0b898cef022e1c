"""The recorder as a process, real DDS, real signals; bags judged by readers of others."""

import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import partial

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from koop_bag_messages import LOOP, padded
from koop_bag_ros import Recorder, Talker, publish, wait_until
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rcl_interfaces.msg import ParameterValue
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader

from koop_bag.bag.columns import read_columns
from koop_bag.bag.earlier import NAMED
from koop_bag.bag.info import describe
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.errors import BagError
from koop_bag.recorder.run_folder import git_revision
from koop_core.ended import PATH
from koop_node.node.managed import message_type
from koop_node.node.rclpy_internals import announce_parameters

pytestmark = pytest.mark.ros

BLOB = "std_msgs/msg/UInt8MultiArray"


def steps(folder, topic="/state"):
    with BagReader(folder) as reader:
        return read_columns(reader, topic, ["step"])["step"].tolist()


def test_a_run_is_recorded_from_its_first_to_its_last_message(tmp_path, messages):
    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        publishers = talker.publishers(LOOP)
        before = time.time_ns()
        publish(publishers, messages.loop, range(10))
        for topic in LOOP:
            recorder.wait_for(topic, 10)
        publish(publishers, messages.loop, range(10, 1000))
        # The signal comes at once: what is still in the queues must not be forgotten.
        recorder.stop(signal.SIGINT)
        after = time.time_ns()
        assert recorder.process.returncode == 0, recorder.output()
        assert "Traceback" not in recorder.output()
        assert "lost messages: none" in recorder.output()
    with BagReader(tmp_path / "run") as reader:
        actual = {topic: list(reader.messages([topic])) for topic in LOOP}
    for topic, items in actual.items():
        assert [m.data for m in items] == [padded(messages.loop(topic, k)) for k in range(1000)]
        sent = [m.publish_time for m in items]
        assert all(before <= m.publish_time <= m.log_time <= after for m in items)
        assert sent == sorted(sent)
    with AnyReader([tmp_path / "run" / "bag"]) as reader:
        decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert len(decoded) >= 4000
    with open(tmp_path / "run" / "bag" / "bag_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert sum(1 for _ in reader.iter_decoded_messages()) == len(decoded)


def test_the_folder_of_a_run_holds_parameters_models_and_versions(tmp_path):
    first, second = tmp_path / "vdp.npz", tmp_path / "other" / "vdp.npz"
    second.parent.mkdir()
    first.write_bytes(b"a model")
    second.write_bytes(b"another model")
    digest = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in (first, second)}
    changed = f"vdp-{digest[second][:12]}.npz"
    options = {"model": str(first), "gains": [0.5, 2.0], "n": 3, "names": ["x", "y"]}
    folder = tmp_path / "run"
    with Recorder(folder) as recorder, Talker("lifter", **options) as talker:
        talker.publishers(LOOP)
        talker.spin_until((folder / "model" / "vdp.npz").is_file, "the model to be kept")
        # one that comes later, and whose model cannot be read
        with Talker("latecomer", model="/proc/self/mem") as other:
            path = folder / "parameters.yaml"
            other.spin_until(lambda: "latecomer" in path.read_text(), "the latecomer's parameters")
        # and a model that a node changes to
        talker.node.set_parameters([Parameter("model", value=str(second))])
        talker.spin_until((folder / "model" / changed).is_file, "the second to be kept")
        recorder.stop(signal.SIGTERM)
        assert recorder.process.returncode == 0, recorder.output()
    parameters = yaml.safe_load((folder / "parameters.yaml").read_text())
    lifter = parameters["/lifter"]["ros__parameters"]
    assert {name: lifter[name] for name in options} == options
    assert parameters["/latecomer"]["ros__parameters"]["model"] == "/proc/self/mem"
    # handed back, the file must not say where this run was recorded
    assert "output" not in parameters["/recorder"]["ros__parameters"]
    assert (folder / "model" / "vdp.npz").read_bytes() == b"a model"
    assert (folder / "model" / changed).read_bytes() == b"another model"
    versions = yaml.safe_load((folder / "versions.yaml").read_text())
    assert versions["python"] == ".".join(map(str, sys.version_info[:3]))
    with BagReader(folder) as reader:
        custom = reader.custom_data()
    assert custom["parameters"] == (folder / "parameters.yaml").read_text()
    assert yaml.safe_load(custom["models"]) == {"vdp.npz": digest[first], changed: digest[second]}


def test_a_node_that_answers_no_question_is_known_by_what_it_announces(tmp_path):
    """As of one that ends before its answer has come: a short run, a busy machine."""
    model, folder = tmp_path / "vdp.npz", tmp_path / "run"
    model.write_bytes(b"a model")
    silent = partial(Node, start_parameter_services=False)
    options = {"model": str(model), "gain": 0.5, "listeners": "recorder"}
    with Recorder(folder) as recorder, Talker("lifter", "", silent, **options) as talker:
        talker.publishers(LOOP)
        announce_parameters(talker.node)
        talker.spin_until((folder / "model" / "vdp.npz").is_file, "the model to be kept")
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    lifter = yaml.safe_load((folder / "parameters.yaml").read_text())["/lifter"]["ros__parameters"]
    assert (lifter["model"], lifter["gain"]) == (str(model), 0.5)
    assert "listeners" not in lifter


def test_lost_steps_are_counted_while_recording_and_at_the_end(tmp_path, messages):
    reports, said = [], []

    def listen(message):
        for status in message.status:
            if status.name.endswith("recorder"):
                reports.append({item.key: item.value for item in status.values})
                said.append(status.message)

    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        talker.node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
        publishers = talker.publishers(LOOP)
        # one of them is of another sender, which tries the topic out
        publish({"/cost": publishers["/cost"]}, messages.loop, [0, 1, 2, 5, 6, 6, 7, 1, 9])
        publish({"/state": publishers["/state"]}, messages.loop, range(20))
        publish({"/theta": publishers["/theta"]}, messages.loop, range(4, 20))
        publishers["/theta"].publish(b"\0\1\0\0" + b"\xff" * 8)  # damaged, of no step
        talker.spin_until(lambda: reports and reports[-1].get("lost /cost") == "3", "a report")
        assert reports[-1]["lost /state"] == "0"
        talker.spin_until(lambda: "lost" not in said[-1], "a second without a loss")
        losses = [text for text in said if "lost" in text]
        assert sum(int(re.fullmatch(r"lost (\d) on /cost", text)[1]) for text in losses) == 3
        assert int(reports[-1]["messages"]) >= 29 + 16
        recorder.wait_for("/theta", 17)
        recorder.stop()
        assert "lost messages: 3 on /cost" in recorder.output()
        assert "/theta begins at step 4, not at 0" in recorder.output()
        assert recorder.process.returncode == 0
    with BagReader(tmp_path / "run") as reader:
        column = read_columns(reader, "/cost", ["step"])["step"]
    report = count_losses(column)
    assert (report.lost, report.duplicates, report.backward) == (3, 1, 1)


def test_what_a_killed_recorder_had_written_is_recovered(tmp_path, messages):
    """Nothing is said to it and nothing more is sent: a chunk waits for its time, not for more."""
    with Recorder(tmp_path / "run") as recorder, Talker("talker", gain=2.5) as talker:
        publish(talker.publishers(LOOP), messages.loop, range(300))
        for topic in LOOP:
            recorder.wait_for(topic, 300)

        def kept():
            with BagReader(tmp_path / "run") as reader:
                return "gain: 2.5" in reader.custom_data().get("parameters", "")

        talker.spin_until(kept, "parameters in the bag")
        recorder.process.kill()
        recorder.process.wait()
    assert not (tmp_path / "run" / "bag" / "metadata.yaml").exists()
    assert recover(tmp_path / "run", tmp_path / "saved").messages >= 1200
    for topic in LOOP:
        assert steps(tmp_path / "saved", topic) == list(range(300))
    with BagReader(tmp_path / "saved") as reader:
        assert "gain: 2.5" in reader.custom_data()["parameters"]
    with AnyReader([tmp_path / "saved"]) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count


def test_a_full_disk_ends_the_recorder_with_an_error_and_the_bag_is_safe(tmp_path, messages):
    with Recorder(tmp_path / "run", file_limit=200_000) as recorder, Talker() as talker:
        publishers = talker.publishers(LOOP)
        for k in range(100_000):
            publish(publishers, messages.loop, [k])
            if recorder.process.poll() is not None:
                break
        publish(publishers, messages.loop, [k])  # the others go on
        output = recorder.process.communicate(timeout=240)[0].decode()
        assert recorder.process.returncode == 1
        assert "no space left" in output
        assert "Traceback" not in output
    actual = steps(tmp_path / "run")
    assert len(actual) > 300
    assert actual == list(range(len(actual)))


def test_what_cannot_be_written_beside_the_bag_ends_the_recorder_and_the_bag_is_whole(tmp_path):
    (tmp_path / "run" / "parameters.yaml").mkdir(parents=True)
    with Recorder(tmp_path / "run") as recorder:
        assert recorder.end() == 1
        assert "cannot write" in recorder.output()
        assert "Traceback" not in recorder.output()
    with BagReader(tmp_path / "run") as reader:
        assert reader.complete


def test_topics_of_the_namespace_are_recorded_whatever_their_qos_and_no_others(tmp_path, messages):
    deadline = Duration(seconds=0.1)
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT, deadline=deadline)
    joints = "sensor_msgs/msg/JointState"
    with Recorder(tmp_path / "run", "-r", "__ns:=/rig") as recorder, Talker() as talker:
        outside = talker.node.create_publisher(message_type(LOOP["/state"]), "/other/state", 10)
        # matched only once the recorder has seen what is offered
        publishers = talker.publishers({"/rig/state": LOOP["/state"]}, qos)
        publish(publishers, lambda _, k: messages.loop("/state", k), range(20))
        publisher = talker.publishers({"/rig/joints": joints})["/rig/joints"]
        publisher.publish(publisher.msg_type(position=[1.0, 2.0]))
        assert outside.get_subscription_count() == 0
        recorder.wait_for("/rig/joints", 1)
        recorder.wait_for("/rig/state", 20)
        recorder.stop()
    assert steps(tmp_path / "run", "/rig/state") == list(range(20))
    with BagReader(tmp_path / "run") as reader:
        assert "/other/state" not in [topic.name for topic in reader.topics]
        assert read_columns(reader, "/rig/joints", ["position"])["position"].tolist() == [[1, 2]]
        offered = yaml.safe_load(reader.topic("/rig/state").metadata["offered_qos_profiles"])
    assert [profile["reliability"] for profile in offered] == ["best_effort"]
    # what discovery does not tell; rosbag2 writes the same
    assert (offered[0]["history"], offered[0]["depth"]) == ("unknown", 0)
    assert offered[0]["deadline"] == {"sec": 0, "nsec": 100_000_000}
    assert offered[0]["lifespan"]["sec"] == 9223372036  # none


def test_topics_outside_the_namespace_are_recorded_if_its_nodes_use_them(tmp_path):
    """Failed before: a rig's own topics were not, and figures were those of the controller."""
    joints = "sensor_msgs/msg/JointState"
    with (
        Recorder(tmp_path / "run", "-r", "__ns:=/loop") as recorder,
        Talker("lifter", "/loop") as lifter,
        Talker("rig") as rig,
    ):
        lifter.collect("/tower/joints", joints)
        others = rig.node.create_publisher(message_type(joints), "/other/joints", 10)
        (publisher,) = rig.publishers({"/tower/joints": joints}).values()
        command = lifter.publishers({"/tower/knob": BLOB})["/tower/knob"]
        rig.spin_until(lambda: publisher.get_subscription_count() == 2, "the recorder to listen")
        publisher.publish(publisher.msg_type(position=[1.0]))
        command.publish(command.msg_type(data=[2]))
        recorder.wait_for("/tower/joints", 1)
        recorder.wait_for("/tower/knob", 1)
        assert others.get_subscription_count() == 0
        recorder.stop()
        assert "Traceback" not in recorder.output()


def test_chosen_topics_are_recorded_while_the_recorder_is_active(tmp_path, messages):
    chosen = "topics:=state /joints:sensor_msgs/msg/JointState"
    types = {"/state": LOOP["/state"], "/joints": "sensor_msgs/msg/JointState"}
    with Recorder(tmp_path / "run", "-p", chosen) as recorder, Talker() as talker:
        unwanted = talker.node.create_publisher(message_type(LOOP["/cost"]), "/cost", 10)
        publishers = talker.publishers(types)
        state = {"/state": publishers["/state"]}

        def change(transition):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert talker.call(ChangeState, "/recorder/change_state", request).success

        publishers["/joints"].publish(publishers["/joints"].msg_type())
        publish(state, messages.loop, range(10))
        recorder.wait_for("/state", 10)
        recorder.wait_for("/joints", 1)
        change(Transition.TRANSITION_DEACTIVATE)
        publish(state, messages.loop, range(10, 20))
        # a message has arrived once its reader has acknowledged it
        assert publishers["/state"].wait_for_all_acked(Duration(seconds=20.0))
        change(Transition.TRANSITION_ACTIVATE)
        publish(state, messages.loop, range(20, 30))
        recorder.wait_for("/state", 20)
        assert unwanted.get_subscription_count() == 0
        recorder.stop()
        assert "lost messages: none" in recorder.output()
    assert steps(tmp_path / "run") == [*range(10), *range(20, 30)]
    with BagReader(tmp_path / "run") as reader:
        assert {topic.name: topic.count for topic in reader.topics} == {"/state": 20, "/joints": 1}


def test_steps_that_a_node_skips_while_it_is_inactive_are_not_lost(tmp_path, messages):
    types = {"/state": LOOP["/state"]}
    with (
        Recorder(tmp_path / "run", "-p", "topics:=state") as recorder,
        Talker(node_class=LifecycleNode) as talker,
    ):
        talker.node.trigger_configure()
        talker.node.trigger_activate()
        publishers = talker.publishers(types)
        events = "/talker/transition_event"
        talker.spin_until(lambda: talker.node.count_subscribers(events), "the recorder to watch")
        publish(publishers, messages.loop, [*range(10), *range(12, 20)])
        recorder.wait_for("/state", 18)
        talker.node.trigger_deactivate()
        talker.node.trigger_activate()
        publish(publishers, messages.loop, range(500, 510))
        recorder.wait_for("/state", 28)
        recorder.stop()
        assert "lost messages: 2 on /state" in recorder.output()
    with BagReader(tmp_path / "run") as reader:
        (topic,) = describe(reader).topics
        assert reader.inactive_steps("/state") == 480
    assert (topic.steps.lost, topic.steps.inactive) == (2, 480)


def test_a_topic_that_falls_silent_though_its_publisher_is_there_is_reported(tmp_path, messages):
    reports = []
    with (
        Recorder(tmp_path / "run", "-p", "topics:=state cost") as recorder,
        Talker(node_class=LifecycleNode) as talker,
    ):
        talker.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
        talker.node.trigger_configure()
        talker.node.trigger_activate()
        publishers = talker.publishers({topic: LOOP[topic] for topic in ("/state", "/cost")})
        publish({"/state": publishers["/state"]}, messages.loop, range(10))

        def said():
            status = reports[-1].status if reports else []
            return [item.message for item in status if "nothing heard" in item.message]

        talker.spin_until(said, "a report")
        assert "nothing heard from /state for" in recorder.output()
        assert "/cost" not in said()[0]  # which never sent anything
        talker.node.trigger_deactivate()  # then nothing is expected
        talker.spin_until(lambda: not said(), "its end")


def test_a_publisher_of_another_type_than_the_one_that_is_recorded_is_told(tmp_path, messages):
    with Recorder(tmp_path / "run") as recorder, Talker() as talker, Talker("other") as other:
        publish(talker.publishers(LOOP), messages.loop, range(10))
        recorder.wait_for("/state", 10)
        assert "/state is published as" not in recorder.output()
        other.node.create_publisher(message_type(BLOB), "/state", 10)
        wait_until(
            lambda: (
                f"/state is published as {BLOB}: only {LOOP['/state']} is recorded"
                in recorder.output()
            ),
            "a word about the other type",
        )
        recorder.stop()
        assert recorder.output().count("/state is published as") == 1


def publish_blobs(talker, recorder, numbers, size=10_000):
    """Publish numbered messages that no compression makes smaller, and wait for the last."""
    (publisher,) = talker.publishers({"/blob": BLOB}).values()
    for k in numbers:
        data = k.to_bytes(4, "little") + random.Random(k).randbytes(size)
        publisher.publish(publisher.msg_type(data=data))

    def recorded():
        actual = read_blobs(recorder.folder)
        return actual and actual[-1] == numbers[-1]

    wait_until(recorded, "the last message")


def read_blobs(folder):
    """Return the numbers of the messages in a bag, or in a file, also while it is recorded."""
    try:
        with BagReader(folder) as reader:
            return [read_number(message.data) for message in reader.messages()]
    except BagError:
        return []


def read_number(data):
    """Return the number of a message: after the header, the layout and the length."""
    return int.from_bytes(data[16:20], "little")


def test_a_ring_keeps_the_newest_files_for_other_readers(tmp_path):
    ring = ("-p", f"topics:=/blob:{BLOB}", "-p", "keep_size:=0.5")
    with Recorder(tmp_path / "run", *ring) as recorder, Talker() as talker:
        publish_blobs(talker, recorder, range(150))
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    bag = tmp_path / "run" / "bag"
    assert sum(path.stat().st_size for path in bag.glob("*.mcap")) < 600_000
    assert not (bag / "bag_0.mcap").exists()
    with AnyReader([bag]) as reader:
        numbers = [read_number(raw) for *_, raw in reader.messages()]
        assert reader.message_count == len(numbers)
    assert numbers == list(range(numbers[0], 150))
    assert len(numbers) > 30


def test_the_recording_around_a_trip_of_the_guard_is_kept_for_good(tmp_path):
    guard = "/koop_guard/state"
    topics = f"topics:=/blob:{BLOB} {guard}:koop_msgs/msg/GuardState"
    with Recorder(tmp_path / "run", "-p", topics, "-p", "keep_size:=2.0") as recorder:
        with Talker() as talker:
            (state,) = talker.publishers({guard: "koop_msgs/msg/GuardState"}).values()
            publish_blobs(talker, recorder, range(100))
            for status, tripped_at in ((1, 0.0), (2, 7.5), (2, 7.5)):
                state.publish(state.msg_type(status=status, tripped_at=tripped_at))
            recorder.wait_for(guard, 3)
            publish_blobs(talker, recorder, range(100, 500))
            recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    with AnyReader([tmp_path / "run" / "bag" / "alarms"]) as reader:
        actual = [(c.topic, raw) for c, _, raw in reader.messages()]
    numbers = [read_number(raw) for topic, raw in actual if topic == "/blob"]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert numbers[0] < 95
    assert 104 < numbers[-1] < 150
    assert [topic for topic, _ in actual].count(guard) == 3


@pytest.mark.parametrize(
    ("status", "reason", "end", "kept"),
    [
        (2, "the loop ends", "the loop ends", False),
        (2, "the guard ends", "the loop ends", False),
        (2, "x on /rig is not a finite number", "the loop ends", True),
        (1, "", "koop_guard was killed by signal 9", True),
    ],
)
def test_a_ring_keeps_the_end_of_a_loop_that_failed_not_of_one_in_order(
    tmp_path, monkeypatch, status, reason, end, kept
):
    """Failed before: a stopped run was kept, at the cost of runs whose guard was killed."""
    (tmp_path / "ended").write_text(end)
    monkeypatch.setenv(PATH, str(tmp_path / "ended"))
    with Recorder(tmp_path / "run", "-p", "keep_size:=2.0") as recorder, Talker() as talker:
        guard = "/koop_guard/state"
        (state,) = talker.publishers({guard: "koop_msgs/msg/GuardState"}).values()
        state.publish(state.msg_type(status=status, reason=reason, tripped_at=7.5))
        recorder.wait_for(guard, 1)
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    assert (tmp_path / "run" / "bag" / NAMED).exists() == kept


def test_damaged_messages_are_recorded_and_end_no_recording(tmp_path):
    """A ring reads some of what it records, and every recorder what parameters change to."""
    kinds = {
        "/koop_guard/state": "koop_msgs/msg/GuardState",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "/state": LOOP["/state"],
        "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
    }
    sizes = 1, 3, 4, 13, 40
    with Recorder(tmp_path / "run", "-p", "keep_size:=5.0") as recorder, Talker() as talker:
        publishers = talker.publishers(kinds)
        for size in sizes:
            for publisher in publishers.values():
                publisher.publish((b"\0\1\0\0" + b"\xff" * 40)[:size])
        events = publishers["/parameter_events"]
        gain = Parameter("gain", value=1.0).to_parameter_msg()
        gain.value = ParameterValue(type=77)
        for name in ("~no-such-user/x", 5000 * "x"):
            model = Parameter("model", value=name).to_parameter_msg()
            event = events.msg_type(node="/other", new_parameters=[gain, model])
            event.changed_parameters = [model]
            events.publish(event)
        for topic in publishers:
            recorder.wait_for(topic, len(sizes))
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    with BagReader(tmp_path / "run") as reader:
        for topic in ("/koop_guard/state", "/state"):
            assert reader.topic(topic).count == len(sizes)
        assert "gain: null" in reader.custom_data()["parameters"]


def test_trips_that_no_room_is_left_for_are_warned_of_once(tmp_path):
    guard, reports = "/koop_guard/state", []
    topics = f"topics:=/blob:{BLOB} {guard}:koop_msgs/msg/GuardState"
    with Recorder(tmp_path / "run", "-p", topics, "-p", "keep_size:=0.5") as recorder:
        with Talker() as talker:
            talker.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 100)
            (state,) = talker.publishers({guard: "koop_msgs/msg/GuardState"}).values()
            for trip in range(10):
                state.publish(state.msg_type(status=2, tripped_at=1.0 + trip))
                recorder.wait_for(guard, 1)  # the ring drops it later
                publish_blobs(talker, recorder, range(30 * trip, 30 * trip + 30))
            talker.spin_until(
                lambda: any("alarms is full" in s.message for r in reports for s in r.status),
                "a warning",
            )
            recorder.stop()
        assert recorder.output().count("alarms is full") == 1
    size = sum(path.stat().st_size for path in (tmp_path / "run" / "bag").rglob("*.mcap"))
    assert size < 600_000


def test_a_ring_that_the_disk_is_too_small_for_shrinks_and_goes_on(tmp_path):
    size = 40 * shutil.disk_usage(tmp_path).total / 1e6  # of which a file is two disks large
    reports = []
    ring = ("-p", f"topics:=/blob:{BLOB}", "-p", f"keep_size:={size}")
    with Recorder(tmp_path / "run", *ring) as recorder, Talker() as talker:
        talker.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 100)
        publish_blobs(talker, recorder, range(400))
        talker.spin_until(
            lambda: any("nearly full" in s.message for r in reports for s in r.status), "a warning"
        )
        publish_blobs(talker, recorder, range(400, 800))
        wait_until(lambda: not {0} & set(read_blobs(recorder.folder)), "the first file to go")
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    with AnyReader([tmp_path / "run" / "bag"]) as reader:
        numbers = [read_number(raw) for *_, raw in reader.messages()]
    assert numbers == list(range(numbers[0], 800))
    assert 0 < numbers[0] <= 700  # at least the newest megabyte is left


def test_a_folder_that_holds_a_recording_is_refused_with_one_line(tmp_path, write_loop):
    write_loop("bag", n=3)
    with Recorder(tmp_path) as recorder:
        assert recorder.end() != 0
        assert "holds a recording already" in recorder.output()
        assert "Traceback" not in recorder.output()
    assert len(steps(tmp_path)) == 3


def test_a_wrong_parameter_is_refused_with_one_line(tmp_path):
    with Recorder(tmp_path / "run", "-p", "queue:=1") as recorder:
        assert recorder.end() == 2
        assert recorder.output().startswith("error: ")
        assert len(recorder.output().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_the_revision_of_a_work_tree_is_told_and_its_index_is_left_alone(tmp_path):
    def git(*words):
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        words = ["git", "-C", str(tmp_path), *who, *words]
        return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()

    assert git_revision(tmp_path) == ""
    file, index = tmp_path / "file", tmp_path / ".git" / "index"
    file.write_text("a")
    git("init")
    git("add", "file")
    git("commit", "-m", "first")
    os.utime(file, (1.0, 1.0))  # git would look at it, and note that it is the same
    before = index.stat().st_mtime_ns, index.read_bytes()
    assert git_revision(tmp_path) == git("rev-parse", "HEAD")
    file.write_text("b")
    assert git_revision(tmp_path) == git("rev-parse", "HEAD") + "-dirty"
    assert (index.stat().st_mtime_ns, index.read_bytes()) == before
