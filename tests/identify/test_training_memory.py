"""`koop train` takes no more memory for a bag that is larger."""

import subprocess
import sys

import numpy as np
import pytest

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema

DT = 0.005
STATE = np.dtype(  # a koop_msgs/MeasuredState of two values as little-endian CDR
    {
        "names": ["encoding", "sec", "nanosec", "frame_id", "step", "count", "x"],
        "formats": ["<u4", "<i4", "<u4", "<u4", "<u8", "<u4", ("<f8", 2)],
        "offsets": [0, 4, 8, 12, 20, 32, 36],
        "itemsize": 52,
    }
)
STORED = STATE.itemsize + 55  # bytes of a message in an uncompressed bag, its index included
TRAIN = """
import sys
from pathlib import Path
from koop_lab.cli.main import main
code = main(sys.argv[1:])
print([line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line][0])
sys.exit(code)
"""


def write_states(folder, count):
    """Write a bag of so many states of a damped oscillation; return its size [B]."""
    k = np.arange(count)
    phase = DT * k % 20.0  # a new trajectory every 20 s
    messages = np.zeros(count, STATE)
    messages["encoding"], messages["frame_id"], messages["count"] = 0x0100, 1, 2
    messages["sec"], messages["nanosec"] = np.divmod(k * round(DT * 1e9), 1_000_000_000)
    messages["step"] = k
    messages["x"] = (np.exp(-0.1 * phase) * (np.cos(phase), np.sin(phase))).T
    with BagWriter(folder, WriterOptions(compression="none")) as bag:
        channel = bag.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        for number, message in enumerate(messages):
            time_ns = 1 + number * round(DT * 1e9)
            bag.write(channel, time_ns, time_ns, message.tobytes())
    return sum(file.stat().st_size for file in folder.glob("*.mcap"))


def peak_of_training(bag):
    """Train on a bag in a process of its own; return the most memory that it held [B]."""
    words = ["train", str(bag), "--dt", str(DT), "--out", str(bag.parent / "model.npz")]
    done = subprocess.run([sys.executable, "-c", TRAIN, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # VmHWM and not the process's ru_maxrss, which includes what its parent held when it forked
    return int(done.stdout.split("VmHWM:")[1].split()[0]) * 1024


def test_a_bag_3_times_as_large_takes_no_more_memory(tmp_path):
    peaks = []
    for megabytes in (10, 30):  # the smaller one fills a batch, which is what is held at once
        size = write_states(tmp_path / str(megabytes), round(megabytes * 1e6 / STORED))
        assert size == pytest.approx(megabytes * 1e6, rel=0.1)
        peaks.append(peak_of_training(tmp_path / str(megabytes)))
    # all messages read in one batch add 70 MB
    assert peaks[1] - peaks[0] < 30e6
