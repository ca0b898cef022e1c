"""Resident memory of a node, of a loop in processes and in one, of each further loop.

A page that n processes share counts as 1/n of it (PSS).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from koop_bench.containers import fleet
from koop_bench.figures import BenchFigure, BenchSettings
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Monitor
from koop_bringup.live.process import START_TIMEOUT, NodeProcess
from koop_loop.parameters import COMPONENTS, make

SETTLED = 400  # steps after which what is made at the first ones is there
SIZES = (1, 10)  # loops in one container, whose difference is what a further one takes
BARE = """
import rclpy
rclpy.init()
node = rclpy.create_node("bare")
print("ready", flush=True)
rclpy.spin(node)
"""


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Measure node by node, then loops."""
    bare = bare_node()
    figures: list[BenchFigure] = []

    def add(what: str, memory: float) -> None:
        value = f"{memory / 1e6:.1f} MB"
        settings.show(f"{what:34}{value:>12}")
        figures.append(BenchFigure(what, value, memory / bare, "a bare rclpy node"))

    add("a bare rclpy node", bare)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        loop_memory(folder / "first", True)  # compiles the kernels if they are not kept yet
        for node in ("recorder", *COMPONENTS):
            with active_node(folder, node) as running:
                add(f"{node} alone", process_memory(running.process.pid))
        add("loop in four processes", sum(loop_memory(folder / "apart", False).values()))
        composed = loop_memory(folder / "composed", True)
        add("loop in one process, and recorder", sum(composed.values()))
        add("loop in one process", composed["container"])
        few, many = (fleet_memory(folder / str(loops), loops) for loops in SIZES)
        add("each further loop", (many - few) / (SIZES[1] - SIZES[0]))
    return figures[1:]


def process_memory(process: int) -> float:
    """Return the memory of a process, by its id [B]."""
    rows = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return float(next(row.split()[1] for row in rows if row.startswith("Pss:"))) * 1024


def bare_node() -> float:
    """Return the memory of a node that does nothing [B]."""
    with subprocess.Popen([sys.executable, "-c", BARE], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            return process_memory(process.pid)
        finally:
            process.kill()


@contextmanager
def active_node(folder: Path, node: str) -> Iterator[NodeProcess]:
    """Run a node alone, once it has reported that it is active."""
    words = ["--ros-args", "-p", f"output:={folder / 'alone'}"] if node == "recorder" else []
    process = NodeProcess(node, words, folder / f"{node}.log")
    try:
        with Monitor() as monitor:

            def active() -> bool:
                if process.poll() is not None:
                    raise process.failure()
                return monitor.progress.values.get(node, {}).get("lifecycle_state") == "active"

            monitor.wait_for(active, START_TIMEOUT, f"{node} to be active")
        yield process
    finally:
        process.stop()


def loop_memory(folder: Path, composed: bool) -> dict[str, float]:
    """Return the memory of every process of a loop that records itself in real time [B]."""
    parameters = make({"vdp_plant": {"duration": 3600.0, "pace": "realtime"}})
    with LiveLoop(folder, parameters, composed=composed) as loop, Monitor("") as monitor:
        monitor.wait_for(lambda: monitor.progress.step > SETTLED, START_TIMEOUT, "the loop")
        return {name: process_memory(pid) for name, pid in loop.process_ids().items()}


def fleet_memory(folder: Path, loops: int) -> float:
    """Return the memory of a container with so many loops, in real time [B]."""
    with fleet(folder, loops, {"vdp_plant": {"pace": "realtime"}}) as running:
        running.wait_until_running(SETTLED)
        return process_memory(running.processes[0].process.pid)
