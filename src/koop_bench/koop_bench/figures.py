"""Results and settings of benchmarks, and measurements of processes."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

QUIET = 0.5  # load average from which on the figures are bounds


@dataclass(frozen=True)
class BenchSettings:
    """Settings of a benchmark, from the options of the command."""

    duration: float | None
    """Length of each measurement [s]; None: the benchmark's own."""
    rounds: int | None
    """Repetitions; None: the benchmark's own."""
    show: Callable[[str], None]
    """Takes the lines that a benchmark prints as it goes on."""


@dataclass(frozen=True)
class BenchFigure:
    """One result of a benchmark: what was measured, its value with the unit."""

    what: str
    value: str
    ratio: float
    """The result over the baseline's, which was measured in the same run."""
    baseline: str
    kept: bool = True
    """Whether a promise that the figure is about was kept."""


def figure_table(figures: Sequence[tuple[str, BenchFigure]]) -> str:
    """Return the figures, by the benchmark's name, as a Markdown table."""
    rows = [
        f"| {name} | {each.what} | {each.value}{'' if each.kept else ' **NOT KEPT**'} "
        f"| {each.ratio:.3g} x {each.baseline} |"
        for name, each in figures
    ]
    return "\n".join(["| benchmark | figure | value | ratio |", "|---|---|---|---|", *rows])


def machine() -> str:
    """Return a line on the machine, the time and the load that it has."""
    load = os.getloadavg()[0]
    info = Path("/proc/cpuinfo").read_text()
    model = re.search(r"^model name\s*: (.*)$", info, re.MULTILINE)
    busy = "" if load < QUIET else "; not a quiet machine: the figures are bounds"
    return (
        f"{datetime.now(timezone.utc):%d %B %Y, %H:%M} UTC, "
        f"{model[1] if model else platform.machine()}, {processors()} processors, Linux "
        f"{platform.release()}, Python {platform.python_version()}, load average {load:.2f}{busy}"
    )


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def processor_time(process: int) -> float:
    """Return the processor time that a process has used [s]."""
    stat = Path(f"/proc/{process}/stat").read_text()
    user, system = stat.rpartition(")")[2].split()[11:13]  # fields 14 and 15, the name is the 2nd
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
