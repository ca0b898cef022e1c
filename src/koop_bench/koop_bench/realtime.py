"""Ticks and state -> theta at 200 Hz and above, as usual and with real-time priority.

Each round is a composed loop. The baseline is a program that does nothing but wake at every tick.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

from koop_bench.containers import measure_fleet
from koop_bench.figures import BenchFigure, BenchSettings, processors
from koop_bench.fleet_report import FleetReport
from koop_core.stream.durations import Durations
from koop_node.process.realtime import apply_priority
from vdp_plant.pacing import tick

DURATION = 60.0  # [s]
RATES = (200.0, 500.0, 1000.0)  # [Hz]
PRIORITY = 50
COLUMNS = (
    "   Hz                       missed ticks   ticks behind [ms]       state -> theta [ms]\n"
    f"{'':44}p99  p99.9   most     p50    p99  p99.9   most   CPU"
)


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Measure every rate: the bare timer, the loop as usual, and with priority; idle and busy."""
    duration = settings.duration or DURATION
    settings.show(f"one composed loop, {duration:g} s a round")
    figures = []
    for busy in (False, True):
        state = "every processor busy" if busy else "nothing else is started"
        settings.show(f"\n{state}\n{COLUMNS}")
        with keep_busy(busy):
            for rate in RATES:
                bare, line = measure_bare(rate, duration)
                settings.show(line)
                if not busy:
                    settings.show(report_line(rate, "usual", measure_fleet(1, rate, duration)))
                loop = measure_fleet(1, rate, duration, PRIORITY)
                settings.show(report_line(rate, "priority", loop))
                what = f"ticks behind, 99.9 %, {rate:g} Hz, {'busy' if busy else 'idle'}"
                behind = loop.behind(0.999)
                value = f"{behind * 1e3:.2f} ms"
                figures.append(BenchFigure(what, value, behind / bare, "a bare timer"))
    return figures


def measure_bare(rate: float, duration: float) -> tuple[float, str]:
    """Run a program that only wakes at every tick; return what 99.9 % are behind [s], and a line.

    It has the priority of the loop.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        behind, late, problems = process.submit(_wake, rate, duration).result()
    quantiles = [behind.quantile(share) for share in (0.99, 0.999, 1.0)]
    columns = " ".join(f"{item * 1e3:6.2f}" for item in quantiles)
    missed = f"{late} of {round(rate * duration)}"
    notes = "".join(f"  ({problem})" for problem in problems)
    return quantiles[1], f"{rate:7.0f} {'bare':12}{missed:>20}  {columns}{notes}"


def _wake(rate: float, duration: float) -> tuple[Durations, int, list[str]]:
    """Only wake, with real-time priority; return how late, ticks missed, and problems."""
    problems = apply_priority(PRIORITY)
    gc.disable()
    period = 1.0 / rate
    behind, late, done, due = Durations(), 0, 0, time.monotonic() + period
    while done + late < round(rate * duration):
        while (now := time.monotonic()) < due:
            time.sleep(due - now)
        behind.add(now - due)
        missed, due = tick(due, period, now)
        late += missed
        done += 1
    return behind, late, problems


def report_line(rate: float, name: str, report: FleetReport) -> str:
    """Return a line of the table."""
    shares = (0.5, 0.99, 0.999, 1.0)
    behind = " ".join(f"{report.behind(share) * 1e3:6.2f}" for share in shares[1:])
    trips = " ".join(f"{report.trip(share) * 1e3:6.2f}" for share in shares)
    missed = f"{report.late} of {report.ticks}"
    return f"{rate:7.0f} {name:12}{missed:>20}  {behind}  {trips} {report.cpu:5.1%}"


@contextmanager
def keep_busy(wanted: bool) -> Iterator[None]:
    """Run a program that never waits on every processor."""
    command = [sys.executable, "-c", "while True: pass"]
    started = [subprocess.Popen(command) for _ in range(processors())] if wanted else []
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()
