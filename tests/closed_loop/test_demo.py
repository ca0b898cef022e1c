"""``koop demo`` as a user runs it, and what is left when it is stopped."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from koop_bag.bag.reader import BagReader
from koop_lab.recorded.run import read_run

pytestmark = pytest.mark.ros

TIMEOUT = 60.0  # [s] to start four processes on a busy machine


def demo(folder, *arguments, **options):
    command = [sys.executable, "-m", "koop_lab", "demo", "--out", str(folder), *arguments]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )


def processes_of(folder):
    """Return the command lines of the running processes that name the folder."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                command = file.read().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if str(folder) in command:
            found.append(command)
    return found


def test_the_demo_leaves_a_folder_that_holds_the_whole_run(tmp_path):
    folder = tmp_path / "run"
    process = demo(folder, "--duration", "20", "--cost", "raw", "--seed", "2")
    printed, _ = process.communicate(timeout=120)
    assert process.returncode == 0, printed
    for text in ("raw cost", "IAE_theta [s]", "5125.7", "lost messages: none", str(folder)):
        assert text in printed
    metrics = json.loads((folder / "metrics.json").read_text())
    for name in ("iae_theta", "ise_theta", "t_theta", "e_r_ss", "rate_hz", "real_time_factor"):
        assert name in metrics
    assert metrics["lost"] == {"state": 0, "cost": 0, "theta": 0, "ground_truth": 0}
    assert metrics["real_time_factor"] == pytest.approx(metrics["rate_hz"] * 0.005)
    assert (folder / "plot.png").read_bytes().startswith(b"\x89PNG")
    for name in ("parameters.yaml", "versions.yaml", "model/vdp.npz", "bag/metadata.yaml"):
        assert (folder / name).is_file(), name
    assert read_run(folder / "bag").step.size == 4000
    again = demo(folder, "--duration", "20")
    printed, _ = again.communicate(timeout=120)
    assert again.returncode == 2
    assert "holds a recording already: choose another --out" in printed


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_demo_that_is_stopped_leaves_a_whole_bag_and_no_process(tmp_path, number):
    folder = tmp_path / "run"
    process = demo(folder, "--pace", "realtime", "--duration", "600")
    deadline = time.monotonic() + TIMEOUT
    bag = folder / "bag" / "bag_0.mcap"
    while not (bag.is_file() and bag.stat().st_size > 50_000):
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline, "the recording did not begin"
        time.sleep(0.05)
    process.send_signal(number)
    printed, _ = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130
    assert printed.rstrip().endswith("interrupted")
    assert "Traceback" not in printed
    assert not processes_of(folder)
    with BagReader(folder / "bag") as reader:
        assert reader.complete
        counts = {topic.name: topic.count for topic in reader.topics}
    assert min(counts[topic] for topic in ("/state", "/cost", "/theta")) > 0
