"""Results and settings of benchmarks, and measurements of processes."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

QUIET = 0.5  # load average from which on the figures are bounds


@dataclass(frozen=True)
class BenchSettings:
    """Settings of a benchmark, from the options of the command.

    Attributes
    ----------
    duration : float or None
        Length of each measurement [s]; None: the benchmark's own.
    rounds : int or None
        Repetitions; None: the benchmark's own.
    python : Path
        Python that has PyDMD and pykoop.
    show : callable
        Takes the lines that a benchmark prints as it goes on.
    """

    duration: float | None
    rounds: int | None
    python: Path
    show: Callable[[str], None]


@dataclass(frozen=True)
class BenchFigure:
    """One result of a benchmark.

    Attributes
    ----------
    what : str
        What was measured.
    value : str
        The result with its unit.
    ratio : float
        The result over the baseline's.
    baseline : str
        The baseline, measured in the same run.
    kept : bool
        Whether a promise that the figure is about was kept.
    """

    what: str
    value: str
    ratio: float
    baseline: str
    kept: bool = True


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
    now = datetime.now(timezone.utc)
    load = os.getloadavg()[0]
    cpu = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        ),
        platform.machine(),
    )
    busy = "" if load < QUIET else "; not a quiet machine: the figures are bounds"
    return (
        f"{now.day} {now:%B %Y}, {now:%H:%M} UTC, {cpu}, {len(processors())} processors, Linux "
        f"{platform.release()}, Python {platform.python_version()}, load average {load:.2f}{busy}"
    )


def processors() -> list[int]:
    """Return the processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def processor_time(process: int) -> float:
    """Return the processor time that a process has used [s]."""
    stat = Path(f"/proc/{process}/stat").read_text()
    user, system = stat.rpartition(")")[2].split()[11:13]  # fields 14 and 15, the name is the 2nd
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
