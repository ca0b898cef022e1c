"""``koop bench``: measurements that print ratios to a baseline of the same run."""

from __future__ import annotations

import argparse
import time
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

from koop_bench.figures import BenchFigure, BenchSettings, figure_table, machine
from koop_core.errors import InputError, KoopError

BENCHMARKS = {  # memory first: this process does not share pages with the nodes yet
    "memory": "resident memory of a node, of a loop, of each further loop in a container",
    "loop": "lockstep rate while recording, beside bare rclpy chains of the same messages",
    "realtime": "missed ticks, jitter and latency at 200 Hz, 500 Hz and 1 kHz, idle and busy",
    "guard": "from a sample beyond its limit to the command on the way to safety, at 200 Hz",
    "fleet": "loops of 200 Hz that this machine holds, and what each costs",
    "record": "losses, cost and bytes of the recorder, and what a killed one loses",
    "start": "koop --help, a node from start to active, the end of a demo, a whole demo",
    "offline": "the offline loop beside C at -O2",
    "identify": "identification beside NumPy's least squares",
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
        "names", nargs="*", metavar="NAME", help="benchmarks (default: all, about 30 min)"
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="of each run (default: the benchmark's own)"
    )
    parser.add_argument(
        "--rounds", type=int, metavar="N", help="repetitions (default: the benchmark's own)"
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
    show = partial(print, flush=True)  # also into a pipe at once
    show(f"Measured by `koop bench {' '.join(args.names)}`".rstrip() + f" on {machine()}.")
    settings = BenchSettings(args.duration, args.rounds, show)
    return 0 if run_benchmarks({name: partial(run, name) for name in names}, settings) else 1


def run(name: str, settings: BenchSettings) -> list[BenchFigure]:
    """Run a benchmark, whose modules are loaded only then."""
    figures: list[BenchFigure] = import_module(f"{__package__}.{name}").run(settings)
    return figures


def run_benchmarks(
    benchmarks: Mapping[str, Callable[[BenchSettings], list[BenchFigure]]], settings: BenchSettings
) -> bool:
    """Run benchmarks one after the other, then show a table; the error of one ends no other.

    Returns whether none failed and every promise was kept.
    """
    figures: list[tuple[str, BenchFigure]] = []
    failed = False
    for name, measure in benchmarks.items():
        settings.show(f"\n{name}: {BENCHMARKS.get(name, name)}")
        begin = time.monotonic()
        try:
            figures += [(name, figure) for figure in measure(settings)]
        except (KoopError, OSError) as error:
            failed = True
            settings.show(f"failed: {error}")
        except Exception:  # a fault of ours, or a process that was killed: it is reported
            failed = True
            settings.show(f"failed: {traceback.format_exc()}")
        settings.show(f"({time.monotonic() - begin:.0f} s)")
    settings.show(f"\n{figure_table(figures)}")
    return not failed and all(figure.kept for _, figure in figures)
