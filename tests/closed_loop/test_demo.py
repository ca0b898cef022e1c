"""``koop demo`` as a user runs it, and what is left when it is stopped."""

import json
import os
import signal
import subprocess
import sys

import pytest
from koop_msgs.msg import ControlInput, MeasuredState
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.duration import Duration
from waiting import TIMEOUT, wait

from koop_bag.bag.reader import BagReader
from koop_bringup.live.loop import LiveLoop
from koop_identify.recording.loop import read_loop
from koop_lab.cli.main import main
from koop_loop.parameters import make

pytestmark = pytest.mark.ros

FAR = 10**9  # a step that no run here comes to


def demo(folder, *arguments, stdout=subprocess.PIPE):
    command = [sys.executable, "-m", "koop_lab", "demo", "--out", str(folder), *arguments]
    return subprocess.Popen(command, stdout=stdout, stderr=subprocess.STDOUT, text=True)


def processes_of(folder):
    """Return the command lines of the running processes that name the folder."""
    actual = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                command = file.read().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if str(folder) in command:
            actual.append(command)
    return actual


def test_the_demo_leaves_a_folder_that_holds_the_whole_run(tmp_path, capsys):
    folder = tmp_path / "run"
    file = tmp_path / "my.yaml"
    file.write_text(
        "vdp_plant: {ros__parameters: {duration: 10, seed: 1}}\n"
        "recorder: {ros__parameters: {queue: 20000, output: /nowhere}}\n"
    )
    process = demo(folder, "--params-file", str(file), "--cost", "raw", "--seed", "2")
    printed, _ = process.communicate(timeout=240)
    assert process.returncode == 0, printed
    for text in ("raw cost", "IAE_theta [s]", "lost: none", str(folder)):
        assert text in printed
    metrics = json.loads((folder / "metrics.json").read_text())
    for name in ("iae_theta", "ise_theta", "t_theta", "e_r_ss", "rate_hz", "real_time_factor"):
        assert name in metrics
    assert metrics["lost"] == {"state": 0, "cost": 0, "theta": 0, "ground_truth": 0}
    assert metrics["real_time_factor"] == pytest.approx(metrics["rate_hz"] * 0.005)
    assert (folder / "plot.png").read_bytes().startswith(b"\x89PNG")
    for name in ("parameters.yaml", "versions.yaml", "model/vdp.npz", "bag/metadata.yaml"):
        assert (folder / name).is_file(), name
    assert read_loop(folder / "bag").closed(folder / "bag").step.size == 2000
    text = (folder / "parameters.yaml").read_text()
    assert "queue: 20000" in text
    assert "seed: 2" in text
    assert "output" not in text
    assert "listeners" not in text
    assert announced(folder) >= {("/vdp_plant", "seed"), ("/koopman_lifter", "model"),
                                 ("/relay_esc", "tau_f")}  # fmt: skip
    assert main(["demo", "--out", str(folder), "--duration", "20"]) == 2
    assert "holds a recording already: choose another --out" in capsys.readouterr().err


def announced(folder):
    """Return node and name of the parameters published before state 1, as mcap reads them."""
    published = {"/state": [], "/parameter_events": []}
    with open(folder / "bag" / "bag_0.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, record, message in reader.iter_decoded_messages([*published]):
            published[channel.topic].append((record.publish_time, message))
    begin = min(at for at, state in published["/state"] if state.step > 0)
    events = [event for at, event in published["/parameter_events"] if at < begin]
    return {(event.node, item.name) for event in events for item in event.new_parameters}


def begun(folder):
    """Return whether a recording holds more than a second."""
    bag = folder / "bag" / "bag_0.mcap"
    return bag.is_file() and bag.stat().st_size > 50_000


def test_who_comes_second_starts_nothing_and_a_killed_demo_leaves_nothing(tmp_path, probe, capsys):
    """The one under way goes on, notes who comes in all the same, and ends with who started it."""
    first, second = tmp_path / "first", tmp_path / "second"
    with open(tmp_path / "printed", "w") as printed:
        process = demo(first, "--pace", "realtime", "--duration", "600", stdout=printed)
    wait(lambda: begun(first), "the recording", process)
    assert main(["demo", "--out", str(second)]) == 2
    refused = capsys.readouterr().err
    assert "another loop runs on ROS domain" in refused
    assert "Set ROS_DOMAIN_ID to a free one, such as " in refused
    assert not second.exists()
    probe.node.create_publisher(MeasuredState, "state", 10)  # nodes that were started by hand
    text = tmp_path / "printed"
    wait(lambda: "note: another loop has joined" in text.read_text(), "the note", process)
    process.kill()
    process.wait()
    wait(lambda: not processes_of(first), "all processes to end")
    assert_whole(first)


def assert_whole(folder):
    """Check that a bag was closed and can be read to its end, by us and by the mcap project."""
    with BagReader(folder / "bag") as reader:
        assert reader.complete
        counts = {topic.name: topic.count for topic in reader.topics}
    assert min(counts[topic] for topic in ("/state", "/cost", "/theta")) > 0
    with open(folder / "bag" / "bag_0.mcap", "rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary.statistics.message_count == sum(counts.values())
        assert sum(1 for _ in make_reader(stream).iter_messages()) == sum(counts.values())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])  # SIGTERM is treated as SIGHUP
def test_a_demo_that_is_stopped_leaves_a_whole_bag_and_no_process(tmp_path, number):
    folder = tmp_path / "run"
    process = demo(folder, "--pace", "realtime", "--duration", "600")
    wait(lambda: begun(folder), "the recording", process)
    process.send_signal(number)
    printed, _ = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130
    assert printed.rstrip().endswith("interrupted")
    assert f"the run until here is in {folder}/" in printed
    assert "Traceback" not in printed
    assert not processes_of(folder)
    assert_whole(folder)


def test_what_composed_nodes_journal_and_what_others_publish_is_recorded_once(tmp_path, probe):
    """The recorder hears none of the loop's topics, until somebody else publishes one."""
    parameters = make({"vdp_plant": {"pace": "realtime", "duration": 1e6}})
    states = probe.collect(MeasuredState, "/state")

    def recorder_hears(topic):
        infos = probe.node.get_subscriptions_info_by_topic(topic)
        return "recorder" in [info.node_name for info in infos]

    with LiveLoop(tmp_path, parameters, composed=True) as loop:
        probe.spin_until(lambda: states, "the first state")
        other = probe.node.create_publisher(ControlInput, "/theta", 10)
        names = ("state", "ground_truth", "cost", "theta")
        probe.spin_until(
            lambda: [n for n in names if recorder_hears(f"/{n}")] == ["theta"], "who hears what"
        )
        for step in range(FAR, FAR + 5):  # of no state: the plant does not obey
            other.publish(ControlInput(step=step, theta=[1.0]))
        assert other.wait_for_all_acked(Duration(seconds=60.0))
        probe.spin_until(lambda: states[-1].step > 500, "half a thousand states")
        loop.end()
    steps = {name: [] for name in names}
    with open(next((tmp_path / "bag").glob("*.mcap")), "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages([f"/{n}" for n in names]):
            steps[channel.topic[1:]].append(message.step)
    assert [step for step in steps["theta"] if step >= FAR] == list(range(FAR, FAR + 5))
    last = len(steps["cost"]) - 1
    assert last > 500
    for name, found in steps.items():
        own = [step for step in found if step < FAR]
        assert own == list(range(len(own))), name
        assert abs(len(own) - 1 - last) <= 1, name
