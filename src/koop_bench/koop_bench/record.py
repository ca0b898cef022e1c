"""``koop bench record``: what a recording loses, costs and takes, and what a killed one lacks."""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from koop_bag.bag.columns import read_columns
from koop_bag.bag.losses import StepReport, count_losses
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.errors import BagError
from koop_bag.recorder.config import LOOP_TOPICS
from koop_bringup.live.fleet_report import processor_time
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_bringup.live.process import NodeProcess, TiedProcess
from koop_core.errors import LiveError
from koop_loop.parameters import make

LIMIT = 0.2  # [s] of messages that a killed recorder may lack
LOOP = 60.0  # [s] of a loop in real time at most
STARTED = 2.0  # [s] of it that are left out
DT = 0.005  # [s]
PATIENCE = 60.0  # [s] for a recorder to start on a busy machine


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("record", help="losses, cost and bytes of the recorder, kills")
    parser.add_argument("--duration", type=float, default=600.0, metavar="S", help="at 200 Hz x 4")
    parser.add_argument("--overload", type=float, default=60.0, metavar="S", help="at 2 kHz x 4")
    parser.add_argument("--kills", type=int, default=20, help="recorders killed at random times")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if a promise is not kept."""
    kept = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for rate, seconds in ((200.0, args.duration), (2000.0, args.overload)):
            if seconds > 0.0:
                report = record_load(folder / f"{rate:g}", rate, seconds)
                print(report.text(), flush=True)
                kept = kept and report.missing == report.counted
                kept = kept and (rate > 200.0 or report.missing == 0)
        if args.duration > 0.0:
            loop, recorder = loop_and_recorder(folder / "loop", min(args.duration, LOOP))
            print(
                f"a loop of 200 Hz in one process {loop:.1%}, its recorder {recorder:.1%}: "
                f"{loop + recorder:.1%} of a core",
                flush=True,
            )
        if args.kills:
            lacking = np.array(kill_recorders(folder / "kills", args.kills))
            print(
                f"{args.kills} recorders killed at random times, 200 Hz x 4: missing [s] "
                + " ".join(f"{item:.3f}" for item in sorted(lacking))
            )
            print(f"median {np.median(lacking):.3f}, most {lacking.max():.3f}; limit {LIMIT}")
            kept = kept and lacking.max() <= LIMIT
    return 0 if kept else 1


@dataclass(frozen=True)
class LoadReport:
    """What a recorder made of a load.

    Attributes
    ----------
    rate, elapsed : float
        Steps a second that were asked for, and how long all took [s].
    sent : int
        Messages of each of the four topics.
    recorded : dict of str to StepReport
        What the steps in the bag say, by topic.
    counted : int
        Losses in all that the recorder reported: gaps, late begins and early ends.
    cpu : float
        Processor time of the recorder as a share of one core.
    stored, payload : float
        Bytes on the disk and serialized bytes, both by message.
    """

    rate: float
    elapsed: float
    sent: int
    recorded: dict[str, StepReport]
    counted: int
    cpu: float
    stored: float
    payload: float

    @property
    def missing(self) -> int:
        """Messages that were sent and are not in the bag."""
        return sum(self.sent - steps.count for steps in self.recorded.values())

    def text(self) -> str:
        """The report for people."""
        total = self.sent * len(self.recorded)
        return (
            f"{self.rate:g} Hz x {len(self.recorded)} for {self.elapsed:.1f} s: {total} messages "
            f"sent, {self.missing} missing, {self.counted} reported as lost; recorder "
            f"{self.cpu:.1%} of a core; {self.stored:.1f} B a message on the disk, "
            f"{self.payload:.1f} B of it payload before compression"
            + ("" if self.missing == self.counted else f"\nNOT REPORTED: {self.recorded}")
        )


def loop_and_recorder(folder: Path, seconds: float) -> tuple[float, float]:
    """Return the processor time of a composed loop and of its recorder as shares of a core."""
    pace = {"pace": "realtime", "duration": STARTED + seconds}
    marks: list[tuple[float, float, float]] = []
    with LiveLoop(folder, make({"vdp_plant": pace}), composed=True) as live:
        pids = live.process_ids()
        container, recorder = pids["container"], pids["recorder"]

        def look(progress: Progress) -> None:
            if progress.step * DT >= STARTED:
                used = processor_time(container), processor_time(recorder)
                marks.append((time.monotonic(), *used))

        live.run(look)
    spent = np.subtract(marks[-1], marks[0])
    return float(spent[1] / spent[0]), float(spent[2] / spent[0])


def record_load(
    folder: Path,
    rate: float,
    seconds: float,
    stall: float = 0.0,
    farewell: float = 10.0,
    **parameters: object,
) -> LoadReport:
    """Record a load of `rate` steps a second on four topics; a stalled recorder is not scheduled.

    Parameters
    ----------
    folder : path
        Of the run.
    rate, seconds : float
        Steps a second, and how long.
    stall : float
        After a second the recorder is stopped until so much more was sent [s], or everything.
    farewell : float
        How long those who sent stay for a recorder that lacks something [s].
    parameters
        Of the recorder.
    """
    recorder = _start_recorder(folder, **parameters)
    load = _start_load(rate, seconds, farewell)
    try:
        last = _progress_to(load, rate)  # the first second is left out
        begin, used = time.monotonic(), processor_time(recorder.process.pid)
        if stall:
            recorder.process.send_signal(signal.SIGSTOP)
            last = _progress_to(load, min(last["sent"] + stall * rate, rate * seconds))
            recorder.process.send_signal(signal.SIGCONT)
        cpu = math.nan  # of a load that is over within the second that is left out
        while said := _progress(load):
            last = said
            if "elapsed" not in said:
                cpu = (processor_time(recorder.process.pid) - used) / (time.monotonic() - begin)
        load.wait()
        code = recorder.stop()
    finally:
        _end(load)
        recorder.stop()
    if code != 0 or "elapsed" not in last:
        raise LiveError(f"recorder ended with exit code {code}:\n{recorder.last_lines()}")
    recorded = {}
    with BagReader(folder) as bag:
        for topic in LOOP_TOPICS:
            recorded[topic] = count_losses(read_columns(bag, f"/{topic}", ["step"])["step"])
        stored = bag.size / bag.message_count
    if any(steps.count > last["sent"] for steps in recorded.values()):
        raise LiveError("another loop is on this ROS domain; set ROS_DOMAIN_ID to a free one")
    return LoadReport(
        rate,
        last["elapsed"],
        int(last["sent"]),
        recorded,
        reported_losses(recorder.log.read_text(errors="replace")),
        cpu,
        stored,
        last["payload"],
    )


def reported_losses(log: str) -> int:
    """Return the losses that a recorder's last words add up to."""
    total = 0
    for line in log.splitlines():
        _, found, losses = line.partition("lost messages: ")
        if found and losses != "none":
            total += sum(int(item.split()[0]) for item in losses.split(", "))
        if match := re.search(r" begins at step (\d+), not at 0| ends (\d+) steps before", line):
            total += int(match[1] or match[2])
    return total


def kill_recorders(folder: Path, count: int, seed: int = 1) -> list[float]:
    """Kill recorders of a running load at random times; return what each lacks [s]."""
    rng = random.Random(seed)
    missing = []
    load = _start_load(200.0, 3600.0)
    try:
        for number in range(count):
            run = folder / str(number)
            recorder = _start_recorder(run)
            try:
                _wait_for_messages(run)
                time.sleep(rng.uniform(0.0, 2.0))
                killed = time.time()
                recorder.process.kill()
            finally:
                recorder.stop()
            saved = folder / f"{number}-saved"
            recover(run, saved)
            with BagReader(saved) as bag:
                last = min(
                    read_columns(bag, f"/{topic}", ["log_time"])["log_time"][-1]
                    for topic in LOOP_TOPICS
                )
            missing.append(killed - float(last) * 1e-9)
    finally:
        _end(load)
    return missing


def _start_recorder(folder: Path, **parameters: object) -> NodeProcess:
    folder.mkdir(parents=True)
    given = {"output": folder, **parameters}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    return NodeProcess("recorder", ["--ros-args", *words], folder / "recorder.log")


def _start_load(rate: float, seconds: float, farewell: float = 10.0) -> TiedProcess:
    given = [str(rate), str(seconds), str(farewell)]
    command = [sys.executable, "-m", "koop_bench.load", *given]
    return TiedProcess(command, stdout=subprocess.PIPE)


def _progress(load: TiedProcess) -> dict[str, float]:
    """Return the next line that a load says; empty at its end."""
    assert load.stdout is not None
    line = load.stdout.readline()
    return dict(json.loads(line)) if line else {}


def _progress_to(load: TiedProcess, steps: float) -> dict[str, float]:
    """Read on until so many steps were sent; return what was said then."""
    last: dict[str, float] = {}
    while last.get("sent", 0) < round(steps) and (said := _progress(load)):
        last = said
    return last


def _end(load: TiedProcess) -> None:
    load.kill()
    load.communicate()


def _wait_for_messages(run: Path) -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            with BagReader(run) as bag:
                if all(bag.topic(f"/{topic}").count for topic in LOOP_TOPICS):
                    return
        except BagError:
            pass
        time.sleep(0.05)
    raise LiveError(f"nothing was recorded in {PATIENCE:g} s: see {run}/recorder.log")
