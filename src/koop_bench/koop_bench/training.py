"""``koop bench training``: peak memory of ``koop train`` on two bags, one 20 times as large."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_loop.training import TrainingConfig, trajectories
from vdp_plant.config import PlantConfig

FACTOR = 20
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
MEASURE = """
import sys
from pathlib import Path
from koop_lab.cli.main import main
code = main(sys.argv[1:])
print([line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line][0])
sys.exit(code)
"""


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("training", help="peak memory of training, small and large bag")
    parser.add_argument(
        "--size", type=float, default=10.0, metavar="MB", help="of the small bag (default 10)"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    peaks = []
    for size in (args.size, args.size * FACTOR):
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "bag"
            stored = write_states(bag, round(size * 1e6 / STORED))
            started = time.perf_counter()
            peaks.append(peak_of_training(bag))
            elapsed = time.perf_counter() - started
        print(
            f"bag of {stored / 1e6:.0f} MB: peak {peaks[-1] / 1e6:.0f} MB, "
            f"{elapsed:.1f} s, both passes and the start of Python included",
            flush=True,
        )
    print(f"{FACTOR} times the bag takes {peaks[1] / peaks[0]:.2f} times the memory")
    return 0


def write_states(folder: Path, count: int) -> int:
    """Write a bag of `count` simulated states; return its size [B]."""
    with BagWriter(folder, WriterOptions(compression="none")) as bag:
        channel = bag.add_topic("/state", load_schema("koop_msgs/msg/MeasuredState"))
        sent = 0
        for states in _simulated():
            for message in serialized(states[:, : count - sent]):
                time_ns = 1 + sent * round(DT * 1e9)
                bag.write_many([(time_ns, channel, time_ns, message)])
                sent += 1
            if sent == count:
                break
    return sum(file.stat().st_size for file in folder.glob("*.mcap"))


def _simulated() -> Iterator[NDArray[np.float64]]:
    """Yield trajectories without end."""
    seed = 0
    while True:
        for states in trajectories(PlantConfig(), TrainingConfig(trajectories=100, seed=seed)):
            if states is not None:
                yield states
        seed += 1


def serialized(states: NDArray[np.float64]) -> list[bytes]:
    """Return states, shape (2, M), as M serialized messages, from step 0 on."""
    messages = np.zeros(states.shape[1], STATE)
    steps = np.arange(states.shape[1])
    messages["encoding"], messages["frame_id"], messages["count"] = 0x0100, 1, 2
    messages["sec"], messages["nanosec"] = np.divmod(steps * round(DT * 1e9), 1_000_000_000)
    messages["step"], messages["x"] = steps, states.T
    return [message.tobytes() for message in messages]


def peak_of_training(bag: Path) -> int:
    """Train on a bag in a process of its own; return the most memory that it held [B].

    Raises
    ------
    ValueError
        If the training fails.
    """
    given = ["train", str(bag), "--dt", str(DT), "--out", str(bag.parent / "model.npz")]
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, *given], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise ValueError(done.stderr.strip())
    # VmHWM and not the process's ru_maxrss, which includes what its parent held when it forked
    return int(done.stdout.split("VmHWM:")[1].split()[0]) * 1024
