"""``koop commission --new``: answers piped in, on a graph with a rig and without one."""

import itertools
import re
import subprocess
import sys
import threading

import pytest
from std_msgs.msg import Float64, Float64MultiArray

from koop_tune.rig.rig_file import read

pytestmark = pytest.mark.ros


def answered(path, answers):
    """Run the command with answers piped in."""
    words = [sys.executable, "-m", "koop_lab", "commission", "--new", str(path)]
    return subprocess.run(words, input=answers, capture_output=True, text=True)


@pytest.fixture
def rig(probe, request):
    """A rig that says three numbers a message, without a stamp, and listens to two Float64.

    The third one does not change.
    """
    tower = probe.node.create_publisher(Float64MultiArray, "/tower", 10)
    for knob in ("stiffness", "damping"):
        probe.node.create_subscription(Float64, f"/tower/{knob}", lambda message: None, 10)
    swing = itertools.cycle((0.5, -0.5))
    period = getattr(request, "param", 0.01)
    probe.node.create_timer(
        period, lambda: tower.publish(Float64MultiArray(data=[x := next(swing), -2.0 * x, 7.0]))
    )
    over = threading.Event()

    def spin():
        while not over.is_set():
            probe.executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    yield
    over.set()
    thread.join()


def test_what_the_graph_shows_is_proposed_and_enter_takes_it(rig, tmp_path):
    path = tmp_path / "rig.yaml"
    answers = "1 \n\n0.01\n2, 1\n\n\n0.5 -1\n1.6, 1\n0.05\n1 0\n\nnone\n3 3\n\n\n"
    done = answered(path, answers)
    assert done.returncode == 0, done.stderr
    config = read(path)
    assert config.measured == "/tower:data[0],data[1]"
    assert config.command == "/tower/stiffness:data, /tower/damping:data"
    assert (config.theta_min, config.theta_max, config.theta_rate) == ((0.5, -1), (1.6, 1), 0.05)
    assert (config.theta_safe, config.channel_min, config.channel_max) == ((1, 0), (), (3, 3))
    assert config.time == 3 * 1800  # of two knobs
    proposed = re.search(
        r"time between two messages of the measured channels \[s\] \[([\d.]+)\]", done.stdout
    )
    assert proposed
    assert 0.005 < float(proposed[1]) < 0.1  # of a timer, on a busy machine
    assert "\ntopic that takes theta: " in done.stdout  # of two none is moved by Enter alone
    assert "field of /tower/damping that takes theta [data]" in done.stdout
    assert config.pace == 1.0
    assert "numbers in a message that change: data[0],data[1]; 1 others do not" in done.stdout
    assert "seen: data[0] -0.5 to 0.5, data[1] -1 to 1" in done.stdout
    assert f"next: ./koop check {path}" in done.stdout


@pytest.mark.parametrize("rig", [0.05], indirect=True)  # [s] between two messages
def test_a_rig_that_is_simulated_faster_is_asked_for_its_pace(rig, tmp_path):
    path = tmp_path / "rig.yaml"
    answers = "1 \n\n0.5\n\n2\n\n0.5\n1.6\n0.05\n1\n\nnone\n3 3\n\n\n"
    done = answered(path, answers)
    assert done.returncode == 0, done.stderr
    assert "is it simulated, faster?" in done.stdout
    assert 3.0 < read(path).pace < 12.0  # a busy machine's timer is late


@pytest.mark.parametrize("rig", [4.0], indirect=True)  # [s] between two messages
def test_of_a_rig_that_speaks_seldom_all_fields_are_proposed(rig, tmp_path):
    """Failed before: with no second message while the fields were looked at, it was a fault."""
    done = answered(tmp_path / "rig.yaml", "1\n")
    assert done.returncode == 2
    assert "numbers in a message: data[0],data[1],data[2]\n" in done.stdout
    assert "no more answers at 'fields of the measured channels" in done.stderr


def test_without_a_rig_it_says_so_and_writes_nothing_half(tmp_path):
    path = tmp_path / "rig.yaml"
    done = answered(path, "/tower\n")
    assert done.returncode == 2
    assert "no topic is published: is the rig running?" in done.stdout
    assert "no more answers at 'fields of the measured channels" in done.stderr
    assert not path.exists()
