"""The recorder as a process, real DDS, real signals; bags judged by readers of others."""

import hashlib
import random
import signal
import subprocess
import sys
import time

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from koop_bag_messages import LOOP
from koop_bag_ros import Recorder, Talker, publish, wait_until
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader

from koop_bag.bag.columns import read_columns
from koop_bag.bag.losses import count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.recorder.topics import message_class

pytestmark = pytest.mark.ros


def steps(folder, topic="/state"):
    with BagReader(folder) as reader:
        return read_columns(reader, topic, ["step"])["step"].tolist()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_is_recorded_from_its_first_to_its_last_message(tmp_path, messages, number):
    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        publishers = talker.publishers(LOOP)
        publish(publishers, messages.loop, range(10))
        for topic in LOOP:
            recorder.wait_for(topic, 10)
        publish(publishers, messages.loop, range(10, 1000))
        # The signal comes at once: what is still in the queues must not be forgotten.
        took = recorder.stop(number)
        assert recorder.process.returncode == 0, recorder.output()
        assert took < 1.0
        assert "Traceback" not in recorder.output()
        assert "lost messages: none" in recorder.output()
    for topic in LOOP:
        assert steps(tmp_path / "run", topic) == list(range(1000))
    with AnyReader([tmp_path / "run" / "bag"]) as reader:
        decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert len(decoded) >= 4000
    with open(tmp_path / "run" / "bag" / "bag_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert sum(1 for _ in reader.iter_decoded_messages()) == len(decoded)


def test_the_stored_bytes_and_times_are_those_that_were_sent(tmp_path, messages):
    with Recorder(tmp_path / "run", "-p", "topics:=state") as recorder, Talker() as talker:
        before = time.time_ns()
        publish(talker.publishers({"/state": LOOP["/state"]}), messages.loop, range(50))
        after = time.time_ns()
        recorder.wait_for("/state", 50)
        recorder.stop()
    with BagReader(tmp_path / "run") as reader:
        found = list(reader.messages())
    assert [m.data for m in found] == [messages.loop("/state", k) for k in range(50)]
    times = [(m.publish_time, m.log_time) for m in found]
    assert all(before <= sent <= received for sent, received in times)
    assert times == sorted(times)
    assert times[-1][0] <= after


def test_the_folder_of_a_run_holds_parameters_model_and_versions(tmp_path, messages):
    model = tmp_path / "vdp.npz"
    model.write_bytes(b"a model")
    given = {"model": str(model), "gains": [0.5, 2.0], "n": 3, "names": ["x", "y"]}
    folder = tmp_path / "run"
    with Recorder(folder) as recorder, Talker("lifter", **given) as talker:
        talker.publishers(LOOP)
        talker.spin_until((folder / "model" / "vdp.npz").is_file, "the model to be kept")
        with Talker("latecomer", late=True) as other:
            path = folder / "parameters.yaml"
            other.spin_until(lambda: "latecomer" in path.read_text(), "the latecomer's parameters")
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    parameters = yaml.safe_load((folder / "parameters.yaml").read_text())
    lifter = parameters["/lifter"]["ros__parameters"]
    assert {name: lifter[name] for name in given} == given
    assert parameters["/latecomer"]["ros__parameters"]["late"] is True
    # handed back, the file must not say where this run was recorded
    assert "output" not in parameters["/recorder"]["ros__parameters"]
    assert (folder / "model" / "vdp.npz").read_bytes() == b"a model"
    versions = yaml.safe_load((folder / "versions.yaml").read_text())
    assert versions["python"] == ".".join(map(str, sys.version_info[:3]))
    with BagReader(folder) as reader:
        custom = reader.custom_data()
        assert custom["parameters"] == (folder / "parameters.yaml").read_text()
    assert yaml.safe_load(custom["parameters"]) == parameters
    digest = hashlib.sha256(b"a model").hexdigest()
    assert yaml.safe_load(custom["models"]) == {"vdp.npz": digest}


def test_a_model_that_a_node_changes_to_is_kept_too(tmp_path):
    first, second = tmp_path / "vdp.npz", tmp_path / "other" / "vdp.npz"
    second.parent.mkdir()
    first.write_bytes(b"a model")
    second.write_bytes(b"another model")
    kept = tmp_path / "run" / "model"
    digest = hashlib.sha256(b"another model").hexdigest()
    with Recorder(tmp_path / "run") as recorder, Talker("lifter", model=str(first)) as talker:
        talker.publishers(LOOP)
        talker.spin_until((kept / "vdp.npz").is_file, "the model to be kept")
        talker.node.set_parameters([Parameter("model", value=str(second))])
        talker.spin_until((kept / f"vdp-{digest[:12]}.npz").is_file, "the second to be kept")
        recorder.stop()
    assert (kept / "vdp.npz").read_bytes() == b"a model"
    assert (kept / f"vdp-{digest[:12]}.npz").read_bytes() == b"another model"
    with BagReader(tmp_path / "run") as reader:
        names = yaml.safe_load(reader.custom_data()["models"])
    assert set(names) == {"vdp.npz", f"vdp-{digest[:12]}.npz"}


def test_lost_steps_are_counted_while_recording_and_at_the_end(tmp_path, messages):
    reports = []

    def listen(message):
        for status in message.status:
            if status.name.endswith("recorder"):
                reports.append({item.key: item.value for item in status.values})

    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        talker.node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
        publishers = talker.publishers(LOOP)
        # one of them is of another sender, which tries the topic out
        publish({"/cost": publishers["/cost"]}, messages.loop, [0, 1, 2, 5, 6, 6, 7, 1, 9])
        publish({"/state": publishers["/state"]}, messages.loop, range(20))
        publish({"/theta": publishers["/theta"]}, messages.loop, range(4, 20))
        talker.spin_until(lambda: reports and reports[-1].get("lost /cost") == "3", "a report")
        assert reports[-1]["lost /state"] == "0"
        assert int(reports[-1]["messages"]) >= 29 + 16
        recorder.wait_for("/theta", 16)
        wait_until(
            lambda: "the topics of / are complete from step 4 on" in recorder.output(), "a line"
        )
        recorder.stop()
        assert "lost messages: 3 on /cost" in recorder.output()
        assert recorder.process.returncode == 0
    with BagReader(tmp_path / "run") as reader:
        column = read_columns(reader, "/cost", ["step"])["step"]
        told = yaml.safe_load(reader.custom_data()["complete_from"])
    report = count_losses(column)
    assert (report.lost, report.duplicates, report.backward) == (3, 1, 1)
    assert told == {"": 4}


TALK = """
import itertools, sys, time
from koop_bag_messages import LOOP, Messages
from koop_bag_ros import Talker
from rclpy.serialization import deserialize_message
messages = Messages()
with Talker() as talker:
    publishers = talker.publishers(LOOP)
    samples = {t: deserialize_message(messages.loop(t, 0), p.msg_type)
               for t, p in publishers.items()}
    due = time.monotonic()
    for k in itertools.count():
        for topic, publisher in publishers.items():
            samples[topic].step = k
            publisher.publish(samples[topic])
        print(k, time.time(), flush=True)
        due += 0.005
        time.sleep(max(0.0, due - time.monotonic()))
"""


def test_what_a_killed_recorder_has_missed_is_a_fifth_of_a_second_at_most(tmp_path, request):
    """4 topics at 200 Hz; SIGKILL leaves no time for anything."""
    rng = random.Random(3)
    for number in range(4):
        folder = tmp_path / f"run{number}"
        command = [sys.executable, "-c", TALK]
        with (
            Recorder(folder) as recorder,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, text=True, cwd=request.path.parent
            ) as talker,
        ):
            try:
                last = 150 + rng.randrange(200)
                while int(talker.stdout.readline().split()[0]) < last:
                    pass
                recorder.process.kill()
                killed = time.time()
                recorder.process.wait()
            finally:
                talker.kill()
        assert not (folder / "bag" / "metadata.yaml").exists()
        saved = tmp_path / f"saved{number}"
        assert recover(folder, saved).messages > 0
        for topic in LOOP:
            assert steps(saved, topic) == list(range(len(steps(saved, topic))))
        with BagReader(saved) as reader:
            assert killed - reader.end_time * 1e-9 < 0.2
            assert "parameters" in reader.custom_data()
        with AnyReader([saved]) as reader:
            assert sum(1 for _ in reader.messages()) == reader.message_count


def test_a_full_disk_ends_the_recorder_with_an_error_and_the_bag_is_safe(tmp_path, messages):
    with Recorder(tmp_path / "run", file_limit=200_000) as recorder, Talker() as talker:
        publishers = talker.publishers(LOOP)
        for k in range(100_000):
            publish(publishers, messages.loop, [k])
            if recorder.process.poll() is not None:
                break
        publish(publishers, messages.loop, [k])  # the others go on
        output = recorder.process.communicate(timeout=30)[0].decode()
        assert recorder.process.returncode == 1
        assert "no space left" in output
        assert "Traceback" not in output
    found = steps(tmp_path / "run")
    assert len(found) > 300
    assert found == list(range(len(found)))


def test_a_model_that_cannot_be_read_is_left_out_of_the_record(tmp_path, messages):
    with Recorder(tmp_path / "run") as recorder, Talker(model="/proc/self/mem") as talker:
        publishers = talker.publishers(LOOP)
        path = tmp_path / "run" / "parameters.yaml"
        talker.spin_until(lambda: path.exists() and "talker" in path.read_text(), "parameters")
        publish(publishers, messages.loop, range(20))
        recorder.stop()
        assert recorder.process.returncode == 0, recorder.output()
    assert steps(tmp_path / "run") == list(range(20))


def test_what_cannot_be_written_beside_the_bag_ends_the_recorder_and_the_bag_is_whole(tmp_path):
    (tmp_path / "run" / "parameters.yaml").mkdir(parents=True)
    with Recorder(tmp_path / "run") as recorder:
        assert recorder.end() == 1
        assert "cannot write" in recorder.output()
        assert "Traceback" not in recorder.output()
    with BagReader(tmp_path / "run") as reader:
        assert reader.complete


def test_publishers_of_any_reliability_are_heard(tmp_path, messages):
    deadline = Duration(seconds=0.1)
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT, deadline=deadline)
    with Recorder(tmp_path / "run") as recorder, Talker() as talker:
        # matched only once the recorder has seen what is offered
        publish(talker.publishers({"/state": LOOP["/state"]}, qos), messages.loop, range(20))
        recorder.wait_for("/state", 20)
        recorder.stop()
    assert steps(tmp_path / "run")[0] == 0
    with BagReader(tmp_path / "run") as reader:
        offered = yaml.safe_load(reader.topic("/state").metadata["offered_qos_profiles"])
    assert [profile["reliability"] for profile in offered] == ["best_effort"]
    # what discovery does not tell; rosbag2 writes the same
    assert (offered[0]["history"], offered[0]["depth"]) == ("unknown", 0)
    assert offered[0]["deadline"] == {"sec": 0, "nsec": 100_000_000}
    assert offered[0]["lifespan"]["sec"] == 9223372036  # none


def test_all_topics_of_the_namespace_are_recorded_and_no_others(tmp_path, messages):
    types = {"/rig/joints": "sensor_msgs/msg/JointState", "/rig/state": LOOP["/state"]}
    arguments = ["-r", "__ns:=/rig"]
    with Recorder(tmp_path / "run", *arguments) as recorder, Talker() as talker:
        outside = talker.node.create_publisher(message_class(LOOP["/state"]), "/other/state", 10)
        publishers = talker.publishers(types)
        publish(
            {"/rig/state": publishers["/rig/state"]}, lambda t, k: messages.loop("/state", k), [0]
        )
        publishers["/rig/joints"].publish(publishers["/rig/joints"].msg_type(position=[1.0, 2.0]))
        assert outside.get_subscription_count() == 0
        recorder.wait_for("/rig/joints", 1)
        recorder.wait_for("/rig/state", 1)
        recorder.stop()
    with BagReader(tmp_path / "run") as reader:
        counts = {topic.name: topic.count for topic in reader.topics}
        assert read_columns(reader, "/rig/joints", ["position"])["position"].tolist() == [[1, 2]]
    assert (counts["/rig/joints"], counts["/rig/state"]) == (1, 1)
    assert "/other/state" not in counts


def test_only_chosen_topics_are_recorded(tmp_path, messages):
    chosen = "topics:=state /joints:sensor_msgs/msg/JointState"
    types = {"/state": LOOP["/state"], "/joints": "sensor_msgs/msg/JointState"}
    with Recorder(tmp_path / "run", "-p", chosen) as recorder, Talker() as talker:
        unwanted = talker.node.create_publisher(message_class(LOOP["/cost"]), "/cost", 10)
        publishers = talker.publishers(types)
        publishers["/joints"].publish(publishers["/joints"].msg_type())
        assert unwanted.get_subscription_count() == 0
        recorder.wait_for("/joints", 1)
        recorder.stop()
    with BagReader(tmp_path / "run") as reader:
        assert {topic.name: topic.count for topic in reader.topics} == {"/state": 0, "/joints": 1}


def test_an_inactive_recorder_records_nothing(tmp_path, messages):
    with Recorder(tmp_path / "run", "-p", "topics:=state") as recorder, Talker() as talker:
        publishers = talker.publishers({"/state": LOOP["/state"]})
        client = talker.node.create_client(ChangeState, "/recorder/change_state")

        def change(transition):
            talker.spin_until(client.service_is_ready, "the recorder's service")
            request = ChangeState.Request(transition=Transition(id=transition))
            future = client.call_async(request)
            talker.spin_until(future.done, "the transition")
            assert future.result().success

        publish(publishers, messages.loop, range(10))
        recorder.wait_for("/state", 10)
        change(Transition.TRANSITION_DEACTIVATE)
        publish(publishers, messages.loop, range(10, 20))
        # a message has arrived once its reader has acknowledged it
        assert publishers["/state"].wait_for_all_acked(Duration(seconds=20.0))
        change(Transition.TRANSITION_ACTIVATE)
        publish(publishers, messages.loop, range(20, 30))
        recorder.wait_for("/state", 20)
        recorder.stop()
        assert "lost messages: none" in recorder.output()
    assert steps(tmp_path / "run") == [*range(10), *range(20, 30)]


def test_a_folder_that_holds_a_recording_is_refused_with_one_line(tmp_path, write_loop):
    write_loop("bag", n=3)
    with Recorder(tmp_path) as recorder:
        wait_until(lambda: recorder.process.poll() is not None, "the recorder to give up")
        assert recorder.process.returncode != 0
        assert "holds a recording already" in recorder.output()
        assert "Traceback" not in recorder.output()
    assert len(steps(tmp_path)) == 3


@pytest.mark.parametrize("wrong", ["compression:=lzma", "topics:=a:b", "colour:=red"])
def test_a_wrong_parameter_is_refused_with_one_line(tmp_path, wrong):
    with Recorder(tmp_path / "run", "-p", wrong) as recorder:
        wait_until(lambda: recorder.process.poll() is not None, "the recorder to give up")
        assert recorder.process.returncode == 2
        assert recorder.output().startswith("error: ")
        assert "Traceback" not in recorder.output()
