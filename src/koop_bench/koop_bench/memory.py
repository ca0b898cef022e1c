"""``koop bench memory``: memory of a node, of a loop in processes and in one, of loops more."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from koop_bringup.live.fleet import Fleet, FleetMonitor
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Monitor
from koop_bringup.live.process import START_TIMEOUT, NodeProcess
from koop_loop.parameters import EXECUTABLES, make

SETTLED = 400  # steps after which what is made at the first ones is there
SIZES = (1, 10)  # loops in one container, whose difference is what a further one takes


class Memory(NamedTuple):
    """Resident memory of processes [B].

    Attributes
    ----------
    pss : float
        A page that n processes share counts as 1/n of it.
    rss : float
        It counts as a whole in each.
    """

    pss: float
    rss: float

    def text(self) -> str:
        """The figures for people."""
        return f"{self.pss / 1e6:7.1f} MB PSS {self.rss / 1e6:7.1f} MB RSS"


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser(
        "memory", help="resident memory of nodes, of a loop, of loops in a container"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        in_loop(folder / "first", True)  # compiles the kernels if they are not kept yet
        for node in EXECUTABLES:
            print(f"{node + ' alone':34}{alone(folder, node).text()}", flush=True)
        for composed, label in ((False, "four processes"), (True, "composed, and its recorder")):
            each = in_loop(folder / label, composed)
            print(f"{label:34}{total(each.values()).text()}", flush=True)
            if composed:
                print(f"{'composed, without the recorder':34}{each['container'].text()}")
        found = {loops: fleet(folder / str(loops), loops) for loops in SIZES}
        for loops, memory in found.items():
            print(f"{f'a container with {loops} loops':34}{memory.text()}")
    few, many = SIZES
    further = (found[many].pss - found[few].pss) / (many - few)
    print(f"{'each further loop':34}{further / 1e6:7.1f} MB PSS")
    return 0


def memory_of(process: int) -> Memory:
    """Return the memory of a process, by its id."""
    rows = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()[1:]
    sizes = {row.split(":")[0]: int(row.split()[1]) * 1024 for row in rows}
    return Memory(float(sizes["Pss"]), float(sizes["Rss"]))


def total(each: Iterable[Memory]) -> Memory:
    """Return the memory of several processes together."""
    found = list(each)
    return Memory(sum(item.pss for item in found), sum(item.rss for item in found))


def alone(folder: Path, node: str) -> Memory:
    """Return the memory of a node that has no others yet."""
    words = ["--ros-args", "-p", f"output:={folder / 'alone'}"] if node == "recorder" else []
    with ExitStack() as stack:
        monitor = stack.enter_context(Monitor())
        process = NodeProcess(node, words, folder / f"{node}.log")
        stack.callback(process.stop)

        def active() -> bool:
            said = monitor.progress.values.get(node, {})
            return said.get("lifecycle_state") == "active"

        monitor.wait_for(active, START_TIMEOUT, f"{node} to be active")
        return memory_of(process.process.pid)


def in_loop(folder: Path, composed: bool) -> dict[str, Memory]:
    """Return the memory of every process of a loop that records itself in real time."""
    parameters = make({"vdp_plant": {"duration": 3600.0, "pace": "realtime"}})
    with LiveLoop(folder, parameters, composed=composed) as loop, Monitor("") as monitor:
        monitor.wait_for(lambda: monitor.progress.step > SETTLED, START_TIMEOUT, "the loop")
        return {name: memory_of(pid) for name, pid in loop.process_ids().items()}


def fleet(folder: Path, loops: int) -> Memory:
    """Return the memory of a container with so many loops, in real time."""
    with (
        Fleet(folder, loops, {"vdp_plant": {"pace": "realtime"}}, containers=1) as running,
        FleetMonitor() as monitor,
    ):
        monitor.wait_until_running(running, SETTLED)
        return memory_of(running.processes[0].process.pid)
