"""``koop bench bags``: our bag writer and reader beside those of the libraries, on the same bag."""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koop_bag.bag.reader import BagReader
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import load_schema
from koop_bag.errors import BagError
from koop_bag.recorder.config import LOOP_TOPICS

RATE = 200  # [Hz]
RATES = (200, 10)  # [Hz] at which writers are killed
KILLED_AFTER = (2222, 3333, 4444, 5555)  # messages; a chunk of 64 KiB holds some 900
OURS = "koop_bag"
OPERATIONS = {
    "write": (
        "write serialized messages",
        (OURS, "mcap_small", "mcap", "mcap_default", "rosbags"),
    ),
    "columns": ("read all fields as arrays", (OURS, "rosbags", "mcap_ros2")),
    "raw": ("read serialized messages", (OURS, "mcap", "rosbags")),
    "torn": ("read a file that ends in mid-chunk", (OURS, "mcap", "rosbags")),
}
NAMES = {
    "mcap_small": "mcap, 6 KiB chunks",  # 0.1 s of this load
    "mcap": "mcap",  # written in chunks of 64 KiB
    "mcap_default": "mcap, 1 MiB chunks",
}


WORKLOADS = Path(__file__).parent / "workloads"


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("bags", help="our bag writer and reader beside the libraries'")
    parser.add_argument("--duration", type=float, default=100.0, metavar="S", help="of the bag")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each, the fastest counts")
    parser.add_argument(
        "--source", type=Path, default=WORKLOADS / "bags.py",
        metavar="FILE",
        help="what is measured",
    )  # fmt: skip
    parser.set_defaults(func=main)


@dataclass(frozen=True)
class Figures:
    """What one operation took.

    Attributes
    ----------
    time : float
        Per message [s].
    memory : float
        Most memory beyond what was held before [B].
    messages : int
        Messages written or read.
    stored : float
        Bytes on the disk by message, of what was written.
    """

    time: float
    memory: float
    messages: int
    stored: float


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    if not args.source.is_file():
        raise ValueError(f"{args.source} is not there: run this in the repository's root")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        count = write_source(folder, round(args.duration * RATE))
        print(f"{count} messages of the topics of a loop")
        for operation, (what, libraries) in OPERATIONS.items():
            best: dict[str, Figures] = {}
            for _ in range(args.rounds):
                for library in libraries:
                    figures = measure(args.source, operation, library, folder)
                    known = best.get(library, figures)
                    best[library] = min(known, figures, key=lambda item: item.time)
            print(f"\n{what:32}{'us/message':>11}{'ratio':>7}{'memory':>11}{'messages':>10}")
            for library, figures in best.items():
                ratio = figures.time / best[OURS].time
                stored = f"{figures.stored:8.1f} B each" if figures.stored else ""
                print(
                    f"  {NAMES.get(library, library):30}{figures.time * 1e6:11.2f}{ratio:7.1f}"
                    f"{figures.memory / 1e6:8.1f} MB{figures.messages:10d}{stored}",
                    flush=True,
                )
        rates = " ".join(f"{f'4 x {rate} Hz':>13}" for rate in RATES)
        print(f"\n{'a killed writer lacks at most':32}{rates}")
        for library in OPERATIONS["write"][1]:
            most = [worst_loss(args.source, library, folder, rate) for rate in RATES]
            seconds = " ".join(f"{item:11.2f} s" for item in most)
            print(f"  {NAMES.get(library, library):30}{seconds}", flush=True)
    return 0


def write_source(folder: Path, steps: int) -> int:
    """Write the bag that all read, and half of it as a torn one; return its messages."""
    from koop_bag.recorder.topics import message_class
    from koop_bench.load import VARIANTS, serialized_variants

    pools = [serialized_variants(message_class(kind)) for kind in LOOP_TOPICS.values()]
    with BagWriter(folder / "source") as writer:
        channels = [
            writer.add_topic(f"/{topic}", load_schema(kind)) for topic, kind in LOOP_TOPICS.items()
        ]
        for k in range(steps):
            now = 1 + k * 1_000_000_000 // RATE
            for channel, pool in zip(channels, pools, strict=True):
                head, tail = pool[k % VARIANTS]
                writer.write(channel, now, now, head + k.to_bytes(8, "little") + tail)
    data = (folder / "source" / "source_0.mcap").read_bytes()
    (folder / "torn").mkdir()
    (folder / "torn" / "torn_0.mcap").write_bytes(data[: len(data) // 2])
    return steps * len(channels)


def measure(source: Path, operation: str, library: str, folder: Path) -> Figures:
    """Run one operation in a process of its own.

    Raises
    ------
    ValueError
        If it fails, for instance because the library is not installed.
    """
    done = _run(source, operation, library, folder)
    if done.returncode:
        raise ValueError(
            f"{operation} with {library}: {done.stderr.strip()} (rosbags is a requirement of "
            "this benchmark and of tests only: pip install rosbags)"
        )
    said = json.loads(done.stdout)
    count = max(said["messages"], 1)
    return Figures(said["time"] / count, said["memory"], said["messages"], said["stored"] / count)


def worst_loss(
    source: Path, library: str, folder: Path, rate: int, after: tuple[int, ...] = KILLED_AFTER
) -> float:
    """Kill a writer after several numbers of messages; return the most that is not on the disk [s].

    Time is that of the messages' stamps: nothing sleeps.
    """
    most = 0.0
    for count in after:
        done = _run(source, "kill", library, folder, str(count), str(rate))
        if done.returncode != -signal.SIGKILL:
            raise ValueError(f"the writer of {library} was not killed: {done.stderr.strip()}")
        try:
            with BagReader(folder / "out") as bag:
                found = bag.message_count
        except BagError:
            found = 0
        most = max(most, (count - found) / (len(LOOP_TOPICS) * rate))
    return most


def _run(
    source: Path, operation: str, library: str, folder: Path, *more: str
) -> subprocess.CompletedProcess[str]:
    for path in sorted((folder / "out").glob("*")):
        path.unlink()
    if (folder / "out").is_dir():
        (folder / "out").rmdir()
    command = [sys.executable, str(source), operation, library, str(folder), *more]
    return subprocess.run(command, capture_output=True, text=True, check=False)
