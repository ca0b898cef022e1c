"""``koop up`` as a user runs it: the rig's own program as the plant, and what ends a run."""

import os
import signal
import subprocess
import sys
import time

import pytest

from koop_bag.bag.reader import BagReader
from koop_bringup.live.process import executable
from koop_bringup.plan import plan
from koop_lab.cli.main import main, parser
from koop_lab.commands.up import read_options
from koop_loop.parameters import read

TIMEOUT = 120.0  # [s] to start four processes on a busy machine
FAST = (  # the first cost of a joined run comes after 0.1 s
    "/**/koopman_lifter: {ros__parameters: {cost: raw, omega_h: 300.0, omega_l: 30.0}}\n"
    "/**/relay_esc: {ros__parameters: {dwell: 0.1, tau_f: 0.1}}\n"
)


@pytest.fixture
def rig_file(tmp_path):
    """Describe a rig whose driver is a program of this machine; here it is another plant."""
    command = f"{executable('vdp_plant')} --ros-args -r __node:=driver -p pace:=realtime"
    file = tmp_path / "rig.yaml"
    file.write_text(f"{FAST}/**/rig: {{ros__parameters: {{command: {command}}}}}\n")
    return file


@pytest.fixture
def up(own_domain, tmp_path):
    """Start the command; what it starts ends with the test."""
    running = []

    def start(file, *options):
        printed = open(tmp_path / f"printed-{len(running)}", "w+")  # noqa: SIM115
        process = subprocess.Popen(
            [sys.executable, "-m", "koop_lab", "up", str(file), *options],
            stdout=printed, stderr=subprocess.STDOUT, text=True, cwd=tmp_path,
        )  # fmt: skip
        process.printed = lambda: open(printed.name).read()  # noqa: SIM115
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(TIMEOUT)
        assert "Traceback" not in process.printed()


def wait_for(condition, process, what):
    deadline = time.monotonic() + TIMEOUT
    while not (actual := condition()):
        assert process.poll() is None, process.printed()
        assert time.monotonic() < deadline, f"{what}: timed out: {process.printed()}"
        time.sleep(0.05)
    return actual


def assert_whole(folder, namespace=""):
    with BagReader(folder / "bag") as reader:
        assert reader.complete
        counts = {topic.name: topic.count for topic in reader.topics}
    assert min(counts[f"{namespace}/{topic}"] for topic in ("state", "cost", "theta")) > 0


def moving(folder):
    """Return whether a recording holds more than a second of a closed loop."""
    bag = folder / "bag" / "bag_0.mcap"
    return lambda: bag.is_file() and bag.stat().st_size > 60_000


def test_ctrl_c_ends_a_rig_s_loop_in_order_and_who_comes_second_is_refused(
    nodes_of, up, rig_file, tmp_path, capsys
):
    first = up(rig_file, "--out", "first")
    wait_for(moving(tmp_path / "first"), first, "the recording")
    wait_for(lambda: "θ = " in first.printed(), first, "a status line")
    nodes = nodes_of(first)
    assert set(nodes) == {"recorder", "esc", "lifter", "rig"}
    second = up(rig_file, "--out", "second")
    assert second.wait(TIMEOUT) == 2
    assert "another loop runs on ROS domain" in second.printed()
    assert not (tmp_path / "second").exists()
    first.send_signal(signal.SIGINT)
    assert first.wait(TIMEOUT) == 0, first.printed()
    printed = first.printed()
    assert "oscillation amplitude" in printed.partition("recording in first/bag")[2], printed
    assert "the figures cover " in printed
    assert not any(os.path.exists(f"/proc/{pid}") for pid in nodes.values())
    assert_whole(tmp_path / "first")
    values = read(tmp_path / "first" / "parameters.yaml")  # what ran is what the file says
    assert (values["koopman_lifter"]["cost"], values["relay_esc"]["dwell"]) == ("raw", 0.1)


def test_a_node_that_dies_ends_the_run_with_its_reason(nodes_of, up, tmp_path):
    file = tmp_path / "simulated.yaml"
    file.write_text(f"{FAST}/two/vdp_plant: {{ros__parameters: {{pace: lockstep}}}}\n")
    process = up(file)
    (folder,) = wait_for(lambda: [*tmp_path.glob("recordings/*-simulated")], process, "a folder")
    wait_for(moving(folder), process, "the recording")
    nodes = nodes_of(process)
    assert set(nodes) == {"recorder", "esc", "lifter", "plant"}
    os.kill(nodes["lifter"], signal.SIGKILL)
    assert process.wait(TIMEOUT) == 2
    assert "koop up: error: koopman_lifter was killed by signal 9" in process.printed()
    assert not any(os.path.exists(f"/proc/{pid}") for pid in nodes.values())
    assert_whole(folder, "/two")


def test_the_launch_starts_the_same(rig_file, tmp_path):
    simulated = tmp_path / "simulated.yaml"
    simulated.write_text("/two/vdp_plant: {ros__parameters: {pace: lockstep, duration: 20}}\n")
    for file, namespace in ((rig_file, ""), (simulated, "two")):
        ours, folder = read_options(
            parser("up").parse_args(["up", str(file), "--out", str(tmp_path)])
        )
        chosen = {"params": str(file), "record": "true", "output": str(tmp_path)}
        assert plan({**chosen, "namespace": namespace}) == ours
        assert folder == tmp_path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "rig.yaml: cannot be read: No such file"),
        (
            "relay_esc: {ros__parameters: {dwel: 3}}",
            "unknown parameter 'dwel': did you mean 'dwell'",
        ),
        ("relay_esc: {ros__parameters: {dwell: long}}", "dwell: expected float, got 'long'"),
        ("rig: {ros__parameters: {command: nowhere}}", "no program 'nowhere' found"),
        (
            "koop_guard: {ros__parameters: {command: '/a:data', on_alarm: nowhere to be found}}",
            "on_alarm = 'nowhere to be found': no program 'nowhere' found",
        ),
        ("nobody: {ros__parameters: {a: 1}}", "has no parameters for /recorder, "),
        ("koopman_lifter: {ros__parameters: {model: a.npz}}", "a.npz: cannot be read"),
    ],
)
def test_what_cannot_be_started_is_said_in_one_line(text, message, tmp_path, capsys):
    file = tmp_path / "rig.yaml"
    if text is not None:
        file.write_text(text)
    assert main(["up", str(file)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("koop up: error: ")
    assert message in error
    assert error.count("\n") == 1
