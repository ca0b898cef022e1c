"""``koop bench``: measurements that print ratios to a baseline of the same run."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from koop_bench.figures import BenchFigure, BenchSettings, figure_table, machine
from koop_core.errors import InputError, KoopError

BENCHMARKS = {  # memory first: this process does not share pages with the nodes yet
    "memory": "resident memory of a node, of a loop, of each further loop in a container",
    "loop": "lockstep rate while recording, beside bare rclpy chains of the same messages",
    "realtime": "missed ticks, jitter and latency at 200 Hz, 500 Hz and 1 kHz, idle and busy",
    "fleet": "loops of 200 Hz that this machine holds, and what each costs",
    "record": "losses, cost and bytes of the recorder, and what a killed one lacks",
    "start": "koop --help, a node from start to active, the stop of a demo, a whole demo",
    "offline": "the offline loop beside C at -O2 and plain Python",
    "identify": "identification beside NumPy, PyDMD and pykoop",
}


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "bench",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Measures this machine. Every figure is a ratio to a baseline of the same "
        "run. Let nothing else\nrun meanwhile.\n\nbenchmarks:\n"
        + "\n".join(f"  {name:10}{what}" for name, what in BENCHMARKS.items()),
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="benchmarks (default: all, about 25 min)"
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="of each run (default: the benchmark's own)"
    )
    parser.add_argument(
        "--rounds", type=int, metavar="N", help="repetitions (default: the benchmark's own)"
    )
    parser.add_argument(
        "--python", type=Path, default=Path(sys.executable), metavar="FILE",
        help="Python that has PyDMD and pykoop, for identify (default: this one)",
    )  # fmt: skip
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="Markdown file for all that is printed"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if a benchmark failed or a promise was not kept."""
    names = args.names or list(BENCHMARKS)
    if unknown := [name for name in names if name not in BENCHMARKS]:
        raise InputError(f"unknown benchmark '{unknown[0]}': choose from {', '.join(BENCHMARKS)}")
    if not (args.duration is None or args.duration > 0.0):
        raise InputError("--duration must be positive")
    if not (args.rounds is None or args.rounds > 0):
        raise InputError("--rounds must be positive")
    head = f"Measured by `koop bench {' '.join(args.names)}`".rstrip() + f" on {machine()}."
    print(head, flush=True)
    settings = BenchSettings(args.duration, args.rounds, args.python, print_now)
    text, kept = run_benchmarks({name: load(name) for name in names}, settings)
    if args.write:
        args.write.write_text(f"# Benchmarks\n\n{head}\n\n{text}\n", encoding="utf-8")
    return 0 if kept else 1


def load(name: str) -> Callable[[BenchSettings], list[BenchFigure]]:
    """Return the function that runs a benchmark; its modules are loaded when it is called."""

    def run(settings: BenchSettings) -> list[BenchFigure]:
        figures: list[BenchFigure] = import_module(f"{__package__}.{name}").run(settings)
        return figures

    return run


def print_now(text: str) -> None:
    """Print a line, also into a pipe at once."""
    print(text, flush=True)


def run_benchmarks(
    benchmarks: Mapping[str, Callable[[BenchSettings], list[BenchFigure]]], settings: BenchSettings
) -> tuple[str, bool]:
    """Run benchmarks one after the other; the error of one ends no other.

    Returns
    -------
    text : str
        The figures as a table and the lines of every benchmark, as Markdown.
    kept : bool
        Whether none failed and every promise was kept.
    """
    figures: list[tuple[str, BenchFigure]] = []
    parts: list[str] = []
    kept = True
    for name, run in benchmarks.items():
        what = BENCHMARKS.get(name, name)
        lines: list[str] = []

        def show(text: str, lines: list[str] = lines) -> None:
            settings.show(text)
            lines.append(text)

        settings.show(f"\n{name}: {what}")
        begin = time.monotonic()
        try:
            figures += [(name, figure) for figure in run(replace(settings, show=show))]
        except KoopError as error:
            kept = False
            show(f"failed: {error}")
        took = time.monotonic() - begin
        parts.append("\n".join([f"## {name}\n\n{what}; {took:.0f} s:\n", "```text", *lines, "```"]))
    table = figure_table(figures)
    settings.show(f"\n{table}")
    return "\n\n".join([table, *parts]), kept and all(figure.kept for _, figure in figures)
