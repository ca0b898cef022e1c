"""The guard over DDS at 200 Hz: from a sample beyond its limit to the command on the way to safety.

A rig of this process publishes samples, each beyond its limit; the guard has tripped by the first
and answers each by its step. The baseline is the period of the rig.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from koop_bench.figures import BenchFigure, BenchSettings
from koop_bench.realtime import PRIORITY, keep_busy
from koop_bringup.live.process import START_TIMEOUT, NodeProcess
from koop_core.errors import LiveError
from koop_node.client.client import Client

DURATION, ROUNDS = 30.0, 3  # [s]
DT = 0.005  # [s]
GOAL = 0.02  # [s]
GUARD = {
    "measured": "/rig/state:x[0]", "command": "/rig/theta:theta[0]", "dt": DT, "theta_min": 0.0,
    "theta_max": 1000.0, "theta_rate": 1.0, "theta_start": 1000.0, "channel_max": [3.0],
}  # fmt: skip


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Measure with all processors busy, as usual and with real-time priority."""
    duration, rounds = settings.duration or DURATION, settings.rounds or ROUNDS
    figures = []
    for busy, priority in ((False, 0), (True, 0), (True, PRIORITY)):
        firsts, delays = [], []
        for _ in range(rounds):
            with keep_busy(busy), tempfile.TemporaryDirectory() as folder:
                reactions = measure(Path(folder), duration, priority)
            firsts.append(reactions[0])
            delays += reactions
        late = float(np.quantile(delays, 0.999, method="higher"))  # one may be infinite
        state = ("every processor busy" if busy else "idle") + ", priority" * bool(priority)
        settings.show(
            f"{state}: {len(delays)} samples, median {np.median(delays) * 1e3:.2f} ms, 99.9 % "
            f"{late * 1e3:.2f} ms, most {max(delays) * 1e3:.2f} ms; from the trip itself at most "
            f"{max(firsts) * 1e3:.2f} ms"
        )
        what = f"sample to command, 99.9 %, {state}"
        value = f"{late * 1e3:.2f} ms"
        figures.append(BenchFigure(what, value, late / DT, "a period", late <= GOAL or not busy))
    return figures


def measure(folder: Path, duration: float, priority: int) -> list[float]:
    """Return the time from each violating sample to its command [s]; the first trips the guard.

    Raises
    ------
    koop_core.errors.LiveError
        If the guard does not answer.
    """
    from koop_msgs.msg import ControlInput, MeasuredState

    words = [f"{name}:={value}" for name, value in {**GUARD, "priority": priority}.items()]
    arguments = ["--ros-args", *(word for text in words for word in ("-p", text))]
    sent: dict[int, float] = {}
    heard: dict[int, float] = {}

    def on_command(command: Any) -> None:
        heard.setdefault(command.step, time.monotonic())

    with Client("bench_rig", udp=False) as client:
        node = client.node
        states = node.create_publisher(MeasuredState, "/rig/state", 1000)
        answers = node.create_publisher(ControlInput, "/theta", 10)
        node.create_subscription(ControlInput, "/rig/theta", on_command, 1000)
        process = NodeProcess("koop_guard", arguments, folder / "guard.log")
        try:
            step, due, begin, end = 0, time.monotonic(), math.inf, time.monotonic() + START_TIMEOUT
            while (now := time.monotonic()) < end:
                client.spin(max(due - now, 0.0))
                if time.monotonic() < due:
                    continue
                step, due = step + 1, due + DT
                if begin == math.inf and len(heard) > 200:  # it follows the controller
                    begin, end = time.monotonic(), time.monotonic() + duration
                    heard.clear()
                violates = begin < math.inf
                if violates:
                    sent[step] = time.monotonic()
                states.publish(MeasuredState(step=step, x=[4.0 if violates else math.sin(step)]))
                if not violates:
                    answers.publish(ControlInput(step=step, theta=[1000.0]))
        finally:
            process.stop(timeout=1.0)  # theta need not return: there is no rig
    if not sent or not heard.keys() & sent.keys():
        raise LiveError(f"the guard does not answer: {process.last_lines()}")
    lost = [step for step in sent if step not in heard and step < max(heard)]
    return [heard[step] - sent[step] for step in sent if step in heard] + [math.inf] * len(lost)
