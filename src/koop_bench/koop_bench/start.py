"""``koop bench start``: how long ``koop --help``, a node's start and a demo's stop take."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Monitor
from koop_bringup.live.process import START_TIMEOUT, NodeProcess
from koop_loop.parameters import EXECUTABLES, make

SHORT = 20.0  # [s] simulated
RECORDED = 400  # steps after which a demo is told to end
DEMO = [sys.executable, "-m", "koop_lab", "demo"]


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser(
        "start", help="koop --help, a node from start to active, the stop of a demo, a whole demo"
    )
    parser.add_argument("--rounds", type=int, default=3, help="of each, the median is printed")
    parser.add_argument(
        "--demo", type=float, default=2500.0, metavar="S", help="simulated time of the whole demo"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    entry = Path(os.environ.get("KOOP_ROOT", ".")) / "koop"

    def show(what: str, function: Callable[[], float]) -> None:
        found = sorted(function() for _ in range(args.rounds))
        each = ", ".join(f"{item:.2f}" for item in found)
        print(f"{what:58}{found[len(found) // 2]:6.2f} s   ({each})", flush=True)

    show("a bare Python that imports rclpy", lambda: _spent([sys.executable, "-c", "import rclpy"]))
    if entry.is_file():
        show("./koop --help", lambda: _spent([str(entry), "--help"]))
        show("./koop demo --help", lambda: _spent([str(entry), "demo", "--help"]))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        at_its_end(folder / "first")  # compiles the kernels if they are not kept yet
        fresh = (folder / str(number) for number in itertools.count())
        for node in EXECUTABLES:
            alone = partial(until_active, fresh, node)
            show(f"{node}, from start to its report of being active", alone)
        show("a demo, from its last step to its last process", lambda: at_its_end(next(fresh)))
        show("a demo in real time, from Ctrl-C to its end", lambda: interrupted(next(fresh)))
        whole, loop = whole_demo(next(fresh), args.demo)
    print(f"koop demo --duration {args.demo:g}: {whole:.1f} s, {loop:.1f} s of it the loop")
    return 0


def _spent(command: list[str]) -> float:
    """Return the wall-clock time of a command [s]."""
    begin = time.monotonic()
    subprocess.run(command, check=True, capture_output=True)
    return time.monotonic() - begin


def until_active(fresh: Iterator[Path], node: str) -> float:
    """Return the time from a node's start until it says that it is active [s]."""
    folder = next(fresh)
    folder.mkdir()
    words = ["--ros-args", "-p", f"output:={folder / 'alone'}"] if node == "recorder" else []
    with ExitStack() as stack:
        monitor = stack.enter_context(Monitor())
        begin = time.monotonic()
        process = NodeProcess(node, words, folder / f"{node}.log")
        stack.callback(process.stop)

        def active() -> bool:
            if process.poll() is not None:
                raise process.failure()
            return monitor.progress.values.get(node, {}).get("lifecycle_state") == "active"

        monitor.wait_for(active, START_TIMEOUT, f"{node} to be active")
        return time.monotonic() - begin


def at_its_end(folder: Path) -> float:
    """Return the time from a loop's last step until none of its processes runs [s]."""
    parameters = make({"vdp_plant": {"duration": SHORT, "pace": "lockstep"}})
    with LiveLoop(folder, parameters, composed=True) as loop:
        loop.run(lambda progress: None)
    ended = time.time()
    with BagReader(folder / "bag") as bag:
        return ended - int(read_columns(bag, "/theta", ["publish_time"])["publish_time"][-1]) / 1e9


def interrupted(folder: Path) -> float:
    """Return the time that a demo in real time takes to end when it is told to [s]."""
    command = [*DEMO, "--pace", "realtime", "--duration", "60", "--out", str(folder)]
    with Monitor("") as monitor, open(os.devnull, "w") as nowhere:
        process = subprocess.Popen(command, stdout=nowhere, stderr=nowhere)
        try:
            monitor.wait_for(lambda: monitor.progress.step > RECORDED, START_TIMEOUT, "the demo")
            begin = time.monotonic()
        finally:
            # as Ctrl-C, which a program that runs in the background ignores
            process.send_signal(signal.SIGTERM)
            process.wait()
        return time.monotonic() - begin


def whole_demo(folder: Path, duration: float) -> tuple[float, float]:
    """Return the wall-clock time of a demo, plot and all, and that of its loop alone [s]."""
    whole = _spent([*DEMO, "--duration", str(duration), "--out", str(folder)])
    said = json.loads((folder / "metrics.json").read_text())
    return whole, (said["steps"] - 1) / said["rate_hz"]
