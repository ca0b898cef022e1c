"""Lockstep rate of the loop beside a bare rclpy chain of the same messages."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bench.figures import BenchFigure, BenchSettings
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.process import TiedProcess
from koop_core.errors import LiveError
from koop_loop.ending import describe_end
from koop_loop.parameters import make

DT = 0.005  # [s] of a step
DURATION = 200.0  # [s] simulated
ROUNDS = 3


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Measure bare chain and loop in turn; the median counts, of rates as of ratios."""
    steps = round((settings.duration or DURATION) / DT)
    rounds: list[tuple[float, ...]] = []
    settings.show(
        f"{steps} steps a round; bare: a -> b -> c -> a, three rclpy processes, same message "
        "types, Fast DDS as it comes;\nraw: the same in one process, bytes in and bytes out; loop: "
        "plant, lifter and controller, while a recorder\nin a process of its own records all topics"
    )
    for number in range(settings.rounds or ROUNDS):
        bare, raw = bare_rate(steps), bare_rate(steps, raw=True)
        apart, composed = loop_rate(steps, False), loop_rate(steps, True)
        rounds.append((apart, composed, apart / bare, composed / bare, composed / raw))
        settings.show(
            f"round {number + 1}: bare {bare:.0f} /s, raw {raw:.0f} /s; loop in processes "
            f"{apart:.0f} /s, {apart / bare:.2f} of bare; in one process {composed:.0f} /s, "
            f"{composed / bare:.2f} of bare, {composed / raw:.2f} of raw"
        )
    apart, composed, of_bare, in_one, of_raw = (
        sorted(each)[len(each) // 2] for each in zip(*rounds, strict=True)
    )
    return [
        BenchFigure("loop in processes", f"{apart:.0f} steps/s", of_bare, "the bare chain"),
        BenchFigure("loop in one process", f"{composed:.0f} steps/s", in_one, "the bare chain"),
        BenchFigure("loop in one process", f"{composed:.0f} steps/s", of_raw, "the raw chain"),
    ]


def loop_rate(steps: int, composed: bool) -> float:
    """Return the lockstep rate [1/s] of plant, lifter, controller and recorder."""
    parameters = make({"vdp_plant": {"duration": steps * DT, "pace": "lockstep"}})
    with tempfile.TemporaryDirectory() as folder:
        with LiveLoop(Path(folder), parameters, composed=composed) as loop:
            loop.run(lambda progress: None)
        with BagReader(Path(folder) / "bag") as bag:
            times = read_columns(bag, "/state", ["log_time"])["log_time"]
    return (times.size - 1) / (int(times[-1]) - int(times[0])) * 1e9


def bare_rate(steps: int, raw: bool = False) -> float:
    """Return the rate [1/s] of a bare chain: typed in three processes, or raw in one."""
    command = [sys.executable, "-m", f"{__package__}.bare_chain"]
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
        raise LiveError(describe_end("the bare chain", first.returncode))
    return float(printed.split()[-1])
