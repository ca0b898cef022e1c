"""Losses, cost and bytes of the recorder, and what a killed one loses."""

from __future__ import annotations

import random
import re
import tempfile
import time
from pathlib import Path

import numpy as np

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bag.bag.recover import recover
from koop_bag.errors import BagError
from koop_bag.recorder.config import LOOP_TOPICS
from koop_bench.containers import DT, fleet, parameters_at
from koop_bench.figures import BenchFigure, BenchSettings, processor_time
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_bringup.live.process import NodeProcess
from koop_core.errors import LiveError
from koop_loop.parameters import make

DURATION = 60.0  # [s]
RATES = (200.0, 2000.0)  # [Hz]
KILLS = 5
LIMIT = 0.2  # [s] of messages that a killed recorder may lack
STARTED = 2.0  # [s] of a loop whose processor time does not count
PATIENCE = 60.0  # [s] for a recorder to start on a busy machine


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Record a loop at its rate and at ten times that; then kill recorders."""
    figures = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for rate in RATES:
            figures += record_loop(folder / f"{rate:g}", rate, settings)
        losses = np.array(kill_recorders(folder / "kills", settings.rounds or KILLS))
    settings.show(
        f"{losses.size} recorders killed at random times, 200 Hz x 4: lost [s] "
        + " ".join(f"{item:.3f}" for item in np.sort(losses))
    )
    most = float(losses.max())
    what = "a killed recorder loses at most"
    return [*figures, BenchFigure(what, f"{most:.3f} s", most / LIMIT, "the limit", most <= LIMIT)]


def record_loop(folder: Path, rate: float, settings: BenchSettings) -> list[BenchFigure]:
    """Record a composed loop at a rate [Hz]; compare the recorder's work with the loop's."""
    seconds = settings.duration or DURATION
    pace = {"pace": "scaled", "time_scale": rate * DT, "duration": (STARTED + seconds) * rate * DT}
    marks: list[tuple[float, float, float]] = []
    with LiveLoop(folder, make({"vdp_plant": pace}), composed=True) as live:
        pids = live.process_ids()

        def mark(progress: Progress) -> None:
            if progress.step >= STARTED * rate:
                loop, recorder = (processor_time(pids[n]) for n in ("container", "recorder"))
                marks.append((time.monotonic(), loop, recorder))

        live.run(mark)
    spent = np.subtract(marks[-1], marks[0])
    loop, recorder = spent[1] / spent[0], spent[2] / spent[0]
    with BagReader(folder / "bag") as bag:
        steps = [read_columns(bag, f"/{topic}", ["step"])["step"] for topic in LOOP_TOPICS]
        stored = bag.size / bag.message_count
        payload = sum(len(message.data) for message in bag.messages()) / bag.message_count
    sent = 1 + max(int(each[-1]) for each in steps)
    # the loop ends with a state, which may be left without an answer
    lost = sum(sent - each.size - (each[-1] == sent - 2) for each in steps)
    reported = reported_losses((folder / "logs" / "recorder.log").read_text(errors="replace"))
    settings.show(
        f"{rate:g} Hz x {len(steps)} for {seconds:g} s: {sent * len(steps)} messages sent, "
        f"{lost} lost, {reported} reported as lost; loop {loop:.1%}\nof a core, recorder "
        f"{recorder:.1%}; {stored:.1f} B a message on the disk, {payload:.1f} B before compression"
    )
    sent_in_all = sent * len(steps)
    kept = lost == reported and (rate > RATES[0] or lost == 0)
    share, at = f"{recorder:.1%} of a core", f"{rate:g} Hz"
    return [
        BenchFigure(f"messages lost, {at}", f"{lost}", lost / sent_in_all, "those sent", kept),
        BenchFigure(f"recorder, {at}", share, recorder / loop, "the loop's own"),
        BenchFigure(f"bytes of a message, {at}", f"{stored:.1f} B", stored / payload, "payload"),
    ]


def reported_losses(log: str) -> int:
    """Return the sum of the losses that a recorder's last lines report."""
    total = 0
    for line in log.splitlines():
        _, reported, losses = line.partition("lost messages: ")
        if reported and losses != "none":
            total += sum(int(item.split()[0]) for item in losses.split(", "))
        if match := re.search(r" begins at step (\d+), not at 0| ends (\d+) steps before", line):
            total += int(match[1] or match[2])
    return total


def kill_recorders(folder: Path, count: int) -> list[float]:
    """Kill recorders of a running loop at random times; return what each lacks [s]."""
    rng = random.Random(1)
    lost = []
    with fleet(folder, 1, parameters_at(200.0)) as running:
        running.wait_until_running()
        namespace = running.namespaces[0]
        topics = [f"{namespace}/{topic}" for topic in LOOP_TOPICS]
        for number in range(count):
            output, saved = folder / str(number), folder / f"{number}-saved"
            words = ["--ros-args", "-r", f"__ns:={namespace}", "-p", f"output:={output}"]
            recorder = NodeProcess("recorder", words, folder / f"recorder{number}.log")
            try:
                wait_for_messages(output, topics)
                running.listen(rng.uniform(0.0, 2.0))
                killed = time.time()
                recorder.process.kill()
            finally:
                recorder.stop()
            recover(output, saved)
            with BagReader(saved) as bag:
                last = min(read_columns(bag, t, ["log_time"])["log_time"][-1] for t in topics)
            lost.append(killed - float(last) * 1e-9)
    return lost


def wait_for_messages(output: Path, topics: list[str]) -> None:
    """Wait until a bag holds a message of each topic."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            with BagReader(output) as bag:
                if all(bag.topic(topic).count for topic in topics):
                    return
        except BagError:
            pass
        time.sleep(0.05)
    raise LiveError(f"nothing was recorded in {PATIENCE:g} s: see {output.parent}")
