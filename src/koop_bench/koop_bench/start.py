"""How long ``koop --help``, a node's start, a demo's end and a whole demo take."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bench.figures import BenchFigure, BenchSettings
from koop_bench.memory import active_node
from koop_bringup.live.loop import LiveLoop
from koop_loop.parameters import COMPONENTS, make

ROUNDS = 3
DURATION = 2500.0  # [s] simulated, of the whole demo
SHORT = 20.0  # [s] simulated
DEMO = [sys.executable, "-m", "koop_lab", "demo"]


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Time each in turn; of the rounds the median counts."""
    entry = Path(os.environ.get("KOOP_ROOT", ".")) / "koop"
    figures: list[BenchFigure] = []
    baseline = 0.0

    def add(what: str, function: Callable[[], float]) -> float:
        times = sorted(function() for _ in range(settings.rounds or ROUNDS))
        median = times[len(times) // 2]
        each = ", ".join(f"{item:.2f}" for item in times)
        settings.show(f"{what:58}{median:6.2f} s   ({each})")
        ratio = median / (baseline or median)
        figures.append(BenchFigure(what, f"{median:.2f} s", ratio, "Python importing rclpy"))
        return median

    baseline = add(
        "a bare Python that imports rclpy",
        lambda: duration_of(sys.executable, "-c", "import rclpy"),
    )
    if entry.is_file():
        add("./koop --help", lambda: duration_of(entry, "--help"))
    with tempfile.TemporaryDirectory() as name:
        fresh = (Path(name) / str(number) for number in itertools.count())
        stop_at_end(next(fresh))  # compiles the kernels if they are not kept yet
        for node in ("recorder", *COMPONENTS):
            start = partial(start_node, fresh, node)
            add(f"{node}, from start to its report of being active", start)
        add("a demo, from its last step to its last process", lambda: stop_at_end(next(fresh)))
        length = settings.duration or DURATION
        whole, loop = whole_demo(next(fresh), length)
    what = f"koop demo --duration {length:g}"
    settings.show(f"{what}: {whole:.1f} s, {loop:.1f} s of it the loop")
    return [*figures[1:], BenchFigure(what, f"{whole:.1f} s", whole / loop, "its loop")]


def duration_of(*command: str | Path) -> float:
    """Return the wall-clock time of a command [s]."""
    begin = time.monotonic()
    subprocess.run(command, check=True, capture_output=True)
    return time.monotonic() - begin


def start_node(fresh: Iterator[Path], node: str) -> float:
    """Return the time from a node's start to its report that it is active [s]."""
    folder = next(fresh)
    folder.mkdir()
    begin = time.monotonic()
    with active_node(folder, node):
        return time.monotonic() - begin


def stop_at_end(folder: Path) -> float:
    """Return the time from a loop's last step until none of its processes runs [s]."""
    parameters = make({"vdp_plant": {"duration": SHORT, "pace": "lockstep"}})
    with LiveLoop(folder, parameters, composed=True) as loop:
        loop.run(lambda progress: None)
    ended = time.time()
    with BagReader(folder / "bag") as bag:
        return ended - int(read_columns(bag, "/theta", ["publish_time"])["publish_time"][-1]) / 1e9


def whole_demo(folder: Path, duration: float) -> tuple[float, float]:
    """Return the wall-clock time of a demo, plot and all, and of its loop alone [s]."""
    whole = duration_of(*DEMO, "--duration", str(duration), "--out", folder)
    metrics = json.loads((folder / "metrics.json").read_text())
    return whole, (metrics["steps"] - 1) / metrics["rate_hz"]
