"""How many loops of 200 Hz this machine holds, and what each costs."""

from __future__ import annotations

from koop_bench.containers import measure_fleet
from koop_bench.figures import BenchFigure, BenchSettings
from koop_bench.fleet_report import FleetReport
from koop_core.errors import LiveError

RATE = 200.0  # [Hz]
DURATION = 20.0  # [s]
PRIORITY = 30  # of the nodes, where the system permits it
LIMIT = 5e-3  # [s] that 99 % of all thetas may take after their states
MISSED = 1e-3  # share of all ticks that may be missed: a machine has other work, too
SIZES = (1, 40, 80, 100, 120, 150, 200)


def run(settings: BenchSettings) -> list[BenchFigure]:
    """Run fleets of growing size until one does not keep the pace."""
    duration = settings.duration or DURATION
    settings.show(
        f"held: 99 % of state -> theta below {LIMIT * 1e3:g} ms, no message lost, no state "
        f"without a theta, less than {MISSED:.1%} of\nthe ticks missed; {duration:g} s each\n"
        "loops   Hz (slowest)     p50     p99   p99.9    most [ms]  missed ticks  lost  CPU a loop"
    )
    held: dict[int, FleetReport] = {}
    for loops in SIZES:
        try:
            each = measure_fleet(loops, RATE, duration, PRIORITY)
        except LiveError as error:
            settings.show(f"{loops:5}  {error}")
            break
        trips = " ".join(f"{each.trip(share) * 1e3:7.2f}" for share in (0.5, 0.99, 0.999, 1.0))
        settings.show(
            f"{loops:5}{each.slowest:15.2f} {trips}{each.late:19}{each.lost:6}"
            f"{each.cpu_per_loop:12.2%}{'' if holds(each) else '  not held'}"
        )
        if not holds(each):
            break
        held[loops] = each
    if not held:
        return [BenchFigure("loops held", "0", 0.0, "one loop", kept=False)]
    most, one = max(held), held[min(held)]
    cpu, trip = held[most].cpu_per_loop, held[most].trip(0.99)
    what, loop = f"processor time of a loop, of {most}", "one loop alone"
    return [
        BenchFigure("loops held", f"{most}", float(most), "one loop"),
        BenchFigure(what, f"{cpu:.2%} of a core", cpu / one.cpu_per_loop, loop),
        BenchFigure(
            f"99 % of state -> theta, {most} loops", f"{trip * 1e3:.2f} ms",
            trip / one.trip(0.99), loop,
        ),
    ]  # fmt: skip


def holds(each: FleetReport) -> bool:
    """Return whether a fleet kept the pace."""
    kept = each.slowest > 0.0 and each.trip(0.99) < LIMIT and not each.lost
    return kept and each.late / each.ticks < MISSED
