"""``koop bench loop``: lockstep rate of the loop beside a bare rclpy chain of the same messages."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_bringup.live.process import TiedProcess
from koop_core.errors import LiveError
from koop_identify.recording.loop import read_run
from koop_loop.ending import told
from koop_loop.parameters import make


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("loop", help="lockstep rate against a bare rclpy chain")
    parser.add_argument("--steps", type=int, default=40_000, help="steps of each measurement")
    parser.add_argument("--rounds", type=int, default=3, help="measurements, bare and loop in turn")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    ratios: list[tuple[float, float, float]] = []
    print(
        f"{args.steps} steps a round; bare: a -> b -> c -> a, three rclpy processes, same message "
        "types, Fast DDS as it comes; raw: the same in one process, bytes in and bytes out; loop: "
        "plant, lifter and controller, while a recorder in a process of its own records all topics"
    )
    for number in range(args.rounds):
        bare, raw = bare_rate(args.steps), bare_rate(args.steps, raw=True)
        apart, composed = loop_rate(args.steps, False), loop_rate(args.steps, True)
        ratios.append((apart / bare, composed / bare, composed / raw))
        print(
            f"round {number + 1}: bare {bare:.0f} /s, raw {raw:.0f} /s; loop in processes "
            f"{apart:.0f} /s, {apart / bare:.2f} of bare; in one process {composed:.0f} /s, "
            f"{composed / bare:.2f} of bare, {composed / raw:.2f} of raw",
            flush=True,
        )
    apart, composed, of_raw = (sorted(each)[len(each) // 2] for each in zip(*ratios, strict=True))
    print(
        f"median: {apart:.2f} of bare in processes, {composed:.2f} of bare and {of_raw:.2f} of raw "
        "in one process"
    )
    return 0


def loop_rate(steps: int, composed: bool) -> float:
    """Return the lockstep rate [1/s] of plant, lifter, controller and recorder."""
    parameters = make({"vdp_plant": {"duration": steps * 0.005, "pace": "lockstep"}})
    with tempfile.TemporaryDirectory() as folder:
        with LiveLoop(Path(folder), parameters, composed=composed) as loop:
            loop.run(_ignore)
        run = read_run(Path(folder) / "bag")
    return (run.counts["state"] - 1) / run.duration


def bare_rate(steps: int, raw: bool = False) -> float:
    """Return the rate [1/s] of a bare chain: typed in three processes, or raw in one."""
    command = [sys.executable, "-m", "koop_bench.bare_chain"]
    words = [str(steps), *(["raw"] if raw else [])]
    others = [] if raw else [TiedProcess([*command, role, *words]) for role in "bc"]
    first = TiedProcess([*command, "abc" if raw else "a", *words], stdout=subprocess.PIPE)
    try:
        printed, _ = first.communicate(timeout=300)
    finally:
        for process in (first, *others):
            process.terminate()
        for process in (first, *others):
            process.wait()
    if first.returncode != 0:
        raise LiveError(told("the bare chain", first.returncode))
    return float(printed.split()[-1])


def _ignore(progress: Progress) -> None:
    """Watch without showing anything."""
