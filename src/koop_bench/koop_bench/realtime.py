"""``koop bench realtime``: ticks and state -> theta at 200 Hz and above, as usual and in real time.

Each round is a composed loop, started as usual, with real-time priority and locked memory, or with
these and on one processor. The baseline is a program that does nothing but wake at every tick. What
a collection of garbage takes is measured beside it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from koop_bringup.live.fleet import processors
from koop_bringup.live.fleet_report import FleetReport
from koop_lab.commands.fleet import measure

RATES = (200.0, 500.0, 1000.0)  # [Hz]
PRIORITY = 50
COLUMNS = (
    "   Hz                       missed ticks   ticks behind [ms]       state -> theta [ms]\n"
    f"{'':44}p99  p99.9   most     p50    p99  p99.9   most   CPU"
)
BARE = "bare"
BUSY = "while True: pass"
COLLECTIONS = """
import gc, time
import koopman_lifter.node, relay_esc.node, vdp_plant.node
from koop_node.process.housekeeping import Housekeeping

def timed():
    begin = time.perf_counter()
    gc.collect()
    return time.perf_counter() - begin

timed()
before = min(timed() for _ in range(5))
Housekeeping(0.0)
made = [[number] for number in range(2000)]  # what a second leaves behind
print(before, min(timed() for _ in range(5)))
"""


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser(
        "realtime", help="missed ticks, jitter and latency at 200 Hz, 500 Hz, 1 kHz and above"
    )
    parser.add_argument("--duration", type=float, default=60.0, metavar="S", help="of each round")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES, metavar="HZ")
    parser.add_argument(
        "--search", action="store_true", help="double the highest rate while no tick is missed"
    )
    parser.add_argument(
        "--busy", action="store_true", help="a program that never waits on every processor"
    )
    parser.add_argument(
        "--variants",
        nargs="+",
        choices=tuple(VARIANTS),
        default=("bare", "usual", "priority"),
        help="(default: bare usual priority)",
    )
    parser.set_defaults(func=main)


VARIANTS: dict[str, dict[str, Any]] = {
    BARE: {},
    "usual": {},
    "priority": {"priority": PRIORITY, "lock_memory": True},
    "pinned": {"priority": PRIORITY, "lock_memory": True, "pinned": True},
}


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    load = "with every processor busy" if args.busy else "nothing else is started"
    print(f"one composed loop, {args.duration:g} s a round, {load}")
    before, after = collections()
    print(
        f"a collection of garbage: {before * 1e3:.1f} ms as Python does it, in mid-tick; "
        f"{after * 1e3:.2f} ms between ticks, of what is new\n\n{COLUMNS}",
        flush=True,
    )
    with _busy(args.busy):
        for variant in args.variants:
            rates = list(args.rates)
            while rates:
                rate = rates.pop(0)
                if variant == BARE:
                    print(bare(rate, args.duration), flush=True)
                    continue
                found = round_of(rate, args.duration, variant)
                print(line(rate, variant, found), flush=True)
                if args.search and not rates and not found.late:
                    rates.append(rate * 1.25)
    return 0


def collections() -> tuple[float, float]:
    """Return what a collection of garbage takes [s]: of everything, and as the nodes do it."""
    done = subprocess.run(
        [sys.executable, "-c", COLLECTIONS], check=True, capture_output=True, text=True
    )
    before, after = map(float, done.stdout.split())
    return before, after


def bare(rate: float, duration: float) -> str:
    """Return the line of a program that only wakes at every tick, with real-time priority."""
    command = [sys.executable, "-m", "koop_bench.bare_timer"]
    done = subprocess.run(
        [*command, str(rate), str(duration), str(PRIORITY)],
        check=True,
        capture_output=True,
        text=True,
    )
    said = json.loads(done.stdout)
    behind = " ".join(f"{item * 1e3:6.2f}" for item in said["behind"])
    missed = f"{said['late']} of {said['done'] + said['late']}"
    notes = "".join(f"  ({problem})" for problem in said["problems"])
    return f"{rate:7.0f} {BARE:12}{missed:>20}  {behind}{notes}"


def round_of(rate: float, duration: float, variant: str) -> FleetReport:
    """Run a composed loop at a rate [Hz] for a time [s]."""
    own = argparse.Namespace(
        rate=rate,
        duration=duration,
        containers=1,
        params_file=None,
        **{"pinned": False, "priority": 0, "lock_memory": False} | VARIANTS[variant],
    )
    return measure(1, own)


def line(rate: float, variant: str, found: FleetReport) -> str:
    """Return a line of the table."""
    shares = (0.5, 0.99, 0.999, 1.0)
    behind = " ".join(f"{found.behind.quantile(s) * 1e3:6.2f}" for s in shares[1:])
    trips = " ".join(f"{found.p(s) * 1e3:6.2f}" for s in shares)
    missed = f"{found.late} of {found.steps + found.late}"
    return f"{rate:7.0f} {variant:12}{missed:>20}  {behind}  {trips} {found.cpu:5.1%}"


@contextmanager
def _busy(wanted: bool) -> Iterator[None]:
    """Keep every processor busy."""
    command = [sys.executable, "-c", BUSY]
    started = [subprocess.Popen(command) for _ in processors()] if wanted else []
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()
