"""``koop bench fleet``: how many loops of 200 Hz this machine holds, and what each costs."""

from __future__ import annotations

import argparse
from typing import Any

from koop_bringup.live.fleet_report import FleetReport
from koop_lab.commands.fleet import add_options, measure

LIMIT = 5e-3  # [s] that 99 % of all thetas may take after their states
SLOWER = 1e-3  # share of all ticks that may be missed: a machine has other work, too
SIZES = (1, 2, 5, 10, 20, 30, 40, 50, 60, 80, 100)
COLUMNS = "loops   Hz (slowest)   p50     p99   p99.9    most [ms]  missed ticks  lost  CPU a loop"


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("fleet", help="loops of 200 Hz that one machine holds")
    add_options(parser)
    parser.add_argument(
        "--sizes",
        type=int,
        nargs="+",
        default=SIZES,
        metavar="N",
        help="numbers of loops, until the first two that do not hold",
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    print(
        f"held: 99 % of state -> theta below {LIMIT * 1e3:g} ms, no message lost, no state "
        f"without a theta, less than {SLOWER:.1%} of the ticks missed; {args.duration:g} s each\n\n"
        f"{COLUMNS}",
        flush=True,
    )
    found: dict[int, FleetReport] = {}
    failed = 0
    for loops in args.sizes:
        found[loops] = each = measure(loops, args)
        failed += not holds(each)
        print(line(loops, each), flush=True)
        if failed == 2:
            break
    print("\n" + drawn(found))
    held = [loops for loops, each in found.items() if holds(each)]
    print(f"\nheld: {max(held, default=0)} loops of {args.rate:g} Hz")
    return 0


def holds(each: FleetReport) -> bool:
    """Return whether a fleet kept the pace."""
    missed = each.late / (each.steps + each.late)
    return each.p(0.99) < LIMIT and not (each.lost or each.unanswered) and missed < SLOWER


def line(loops: int, each: FleetReport) -> str:
    """Return a line of the table."""
    trips = " ".join(f"{each.p(share) * 1e3:7.2f}" for share in (0.5, 0.99, 0.999, 1.0))
    return (
        f"{loops:5}{min(each.rates):15.2f} {trips}{each.late:19}{each.lost + each.unanswered:6}"
        f"{each.cpu_per_loop:12.2%}{'' if holds(each) else '  not held'}"
    )


def drawn(found: dict[int, FleetReport]) -> str:
    """Return the cost of a loop against their number, as bars."""
    most = max(each.cpu_per_loop for each in found.values())
    lines = [
        f"{loops:5} {each.cpu_per_loop:7.2%} {'#' * round(50 * each.cpu_per_loop / most)}"
        for loops, each in found.items()
    ]
    return "\n".join(["loops, processor time of each as a share of a core", *lines])
