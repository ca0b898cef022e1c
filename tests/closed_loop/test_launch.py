"""The launch file with the real launch, where ROS 2's own is installed: it is not on PyPI."""

import os
import signal
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from koop_bag.bag.earlier import NAMED
from koop_bag.bag.reader import BagReader
from koop_core.config import parameter_file
from koop_tune.rig.rig_file import as_values

pytest.importorskip("launch_ros", reason="launch is not on PyPI")
sys.path.insert(0, str(Path(__file__).parents[1] / "commission"))

from commission_rig import DT, RIG, FastRig
from waiting import TIMEOUT, wait

FILE = Path(__file__).parents[2] / "src" / "koop_bringup" / "launch" / "closed_loop.launch.py"
RUN = """
import sys
from ros2launch.api import launch_a_launch_file
file, *words = sys.argv[1:]
sys.exit(launch_a_launch_file(launch_file_path=file, launch_file_arguments=words))
"""
pytestmark = pytest.mark.ros


@pytest.fixture
def launch(own_domain, tmp_path, monkeypatch):
    """Start the launch file; what it starts ends with the test."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    running = []

    def start(*arguments, file=FILE):
        process = subprocess.Popen(
            [sys.executable, "-c", RUN, str(file), *arguments],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, cwd=tmp_path, start_new_session=True,
        )  # fmt: skip
        running.append(process)
        return process

    yield start
    for process in running:
        press_ctrl_c(process)
        try:
            process.communicate(timeout=TIMEOUT)
        finally:
            process.kill()


def press_ctrl_c(process):
    """Send SIGINT to all processes of the terminal, as it does."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)


def is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_bad_argument_starts_no_node(launch):
    for argument in ("duration:=abc", "pace:=foo", "durations:=3"):
        process = launch(argument)
        printed, _ = process.communicate(timeout=TIMEOUT)
        assert process.returncode == 1
        assert argument.split(":=")[-1] in printed or "unknown argument" in printed
        assert "process started" not in printed


def test_a_run_s_own_parameters_run_the_same_experiment_again(launch, tmp_path):
    mine = tmp_path / "my.yaml"
    mine.write_text(
        "vdp_plant: {ros__parameters: {pace: lockstep, duration: 2, seed: 7}}\n"
        "koopman_lifter: {ros__parameters: {cost: raw}}\n"
        "recorder: {ros__parameters: {queue: 20000}}\n"
    )
    contents = []
    for arguments, folder in (
        ((f"params:={mine}", f"output:={tmp_path / 'first'}"), "first"),
        ((f"params:={tmp_path / 'first' / 'parameters.yaml'}",), "recordings/*"),
    ):
        process = launch("record:=true", *arguments)
        printed, _ = process.communicate(timeout=TIMEOUT)
        assert process.returncode == 0, printed
        (out,) = tmp_path.glob(folder)
        with BagReader(out / "bag") as bag:
            contents.append(
                [[m.data for m in bag.messages([topic])] for topic in ("/cost", "/theta")]
            )
    assert [len(messages) for messages in contents[0]] == [400, 400]
    assert contents[0] == contents[1]
    text = (out / "parameters.yaml").read_text()
    for line in ("seed: 7", "cost: raw", "queue: 20000", "pace: lockstep"):
        assert line in text


@pytest.mark.parametrize(
    ("executable", "name", "composed", "count"),
    [
        ("lifter", "koopman_lifter", "false", 4),
        ("recorder", "recorder", "false", 4),
        ("container", "container", "true", 2),
    ],
)
def test_the_end_of_a_node_ends_the_launch_with_its_reason(
    nodes_of, launch, executable, name, composed, count
):
    process = launch("record:=true", f"composed:={composed}")
    nodes = wait(lambda: len(actual := nodes_of(process)) == count and actual, "nodes", process)
    os.kill(nodes[executable], signal.SIGKILL)
    printed, _ = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert f"{name} was killed by signal 9" in printed


def test_the_nodes_end_with_a_launch_that_is_killed(nodes_of, launch, tmp_path):
    process = launch("record:=true", f"output:={tmp_path / 'run'}")
    bag = tmp_path / "run" / "bag" / "bag_0.mcap"
    wait(lambda: bag.is_file() and bag.stat().st_size > 50_000, "the bag", process)
    nodes = nodes_of(process)
    assert len(nodes) == 4
    process.kill()
    wait(lambda: not any(map(is_running, nodes.values())), "the nodes to end")
    with BagReader(bag.parent) as reader:
        assert reader.complete


@pytest.mark.parametrize("count", range(5))
def test_ctrl_c_while_the_nodes_start_is_an_orderly_end(nodes_of, launch, tmp_path, count):
    process = launch("record:=true")
    started = lambda: (tmp_path / "log").is_dir() and len(nodes_of(process)) >= count  # noqa: E731
    wait(started, "nodes", process)
    press_ctrl_c(process)
    printed, _ = process.communicate(timeout=TIMEOUT)
    assert "Traceback" not in printed
    assert process.returncode == 0, printed


def test_a_rig_keeps_its_controller_when_the_recorder_ends(nodes_of, launch, tmp_path):
    process = launch("plant:=false", "record:=true")
    nodes = wait(lambda: len(actual := nodes_of(process)) == 3 and actual, "nodes", process)
    os.kill(nodes["recorder"], signal.SIGKILL)
    text = "recorder was killed by signal 9: the loop goes on without it"
    log = tmp_path / "log" / "latest" / "launch.log"
    wait(lambda: text in log.read_text(), text, process)
    press_ctrl_c(process)
    printed, _ = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1
    assert printed.count("process has finished cleanly") == 2


def test_a_recording_holds_how_theta_returned_when_the_guard_was_killed(nodes_of, launch, tmp_path):
    # from the farthest theta that the guard allows, theta would need longer than the test waits
    values = {
        "koopman_lifter": {"cost": "raw", "dt": DT, "measured": RIG.measured},
        "relay_esc": {"theta_min": 0.4, "theta_max": 0.9, "theta_initial": 0.5, "rate_limit": 4.0},
        "koop_guard": {
            name: as_values(RIG)[name]
            for name in ("measured", "command", "dt", "theta_start")
        } | {"theta_min": 0.4, "theta_max": 1e3, "theta_rate": 0.2, "theta_safe": RIG.theta_safe},
        "recorder": {"keep_size": 1000.0},
    }  # fmt: skip
    parameter_file.write(values, tmp_path / "loop.yaml")
    rig = FastRig()
    try:
        out = f"output:={tmp_path / 'run'}"
        process = launch(f"params:={tmp_path / 'loop.yaml'}", "record:=true", out)
        wait(lambda: rig.theta < 0.6, "theta to move", process)
        os.kill(nodes_of(process)["guard"], signal.SIGKILL)
        printed, _ = process.communicate(timeout=TIMEOUT)
    finally:
        rig.close()
    assert (process.returncode, rig.theta) == (1, RIG.theta_safe), printed
    assert "koop_guard was killed by signal 9" in printed
    assert (tmp_path / "run" / "bag" / NAMED).exists()  # failed before: it was an orderly end
    with BagReader(tmp_path / "run" / "bag") as bag:
        *_, last = bag.messages(["/fast/knob"])
    assert struct.unpack("<d", last.data[4:]) == (RIG.theta_safe,)


TWO = """
from ament_index_python.packages import get_package_share_path
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import SetParameter

FILE = str(get_package_share_path("koop_bringup") / "launch" / "closed_loop.launch.py")


def loop(namespace, **given):
    arguments = {"namespace": namespace, "pace": "lockstep", **given}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(FILE), launch_arguments=arguments.items()
    )


def generate_launch_description():
    return LaunchDescription([
        GroupAction([SetParameter("seed", 5), loop("one", duration="1.0")]),
        GroupAction([loop("two", duration="20.0")]),
    ])
"""


def test_two_loops_in_one_launch_end_apart(launch, tmp_path):
    file = tmp_path / "two.launch.py"
    file.write_text(TWO)
    process = launch(file=file)
    printed, _ = process.communicate(timeout=2 * TIMEOUT)
    assert process.returncode == 0, printed
    assert "unknown parameter" not in printed
    assert printed.index("done: 200 steps") < printed.index("done: 4000 steps")
