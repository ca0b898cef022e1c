"""``koop fleet``: many simulated loops on this machine, and how well they keep the pace."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from koop_bringup.live.fleet import Fleet, FleetMonitor, processors
from koop_bringup.live.fleet_report import FleetReport, processor_time, report
from koop_core.config.parameter import ConfigError
from koop_loop import parameters

SETTLED = 2.0  # [s] after the last loop has begun


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "fleet",
        description="Runs simulated loops in the namespaces /loop0, /loop1 ... of this ROS domain, "
        "several to a process, a process a processor, and says how well they kept the pace.",
    )
    parser.add_argument("loops", type=int, metavar="N", help="number of loops")
    add_options(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="keep logs and parameters there (default: nowhere)"
    )
    parser.set_defaults(func=main)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how the loops of a fleet run."""
    parser.add_argument("--duration", type=float, default=30.0, metavar="S", help="(default 30)")
    parser.add_argument(
        "--rate", type=float, default=200.0, metavar="HZ", help="steps a second (default 200)"
    )
    parser.add_argument(
        "--containers", type=int, default=0, metavar="C", help="processes (default: one a core)"
    )
    parser.add_argument("--params-file", metavar="FILE", help="ROS 2 parameter file of the nodes")
    parser.add_argument(
        "--pinned", action="store_true", help="each process keeps to a processor of its own"
    )
    parser.add_argument(
        "--priority", type=int, default=0, metavar="P", help="real-time priority, where permitted"
    )
    parser.add_argument("--lock-memory", action="store_true", help="no page of it is swapped out")


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if a message was lost or a state not answered."""
    if not 1 <= args.loops <= 1000:
        raise ConfigError(f"{args.loops} loops: choose 1 to 1000")
    containers = min(args.containers or len(processors()), args.loops)
    print(
        f"{args.loops} loops of {args.rate:g} Hz in {containers} processes, {args.duration:g} s",
        flush=True,
    )
    found = measure(args.loops, args, args.out)
    print(found.text())
    return 1 if found.lost or found.unanswered else 0


def values_of(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that the options ask for.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used.
    """
    if not (1.0 <= args.rate <= 100_000.0 and args.duration > 0.0 and args.containers >= 0):
        raise ConfigError("--rate must be 1 to 100000 Hz, --duration and --containers positive")
    given = parameters.read(args.params_file) if args.params_file else {}
    made = parameters.make(given)
    made.load_model()
    scale = args.rate * made.plant.dt
    pace = {"pace": "realtime"}
    if abs(scale - 1.0) > 1e-9:
        pace = {"pace": "scaled", "time_scale": scale}
    own = {"priority": args.priority, "lock_memory": args.lock_memory}
    values = {name: {**given.get(name, {}), **own} for name in parameters.NODES}
    values["vdp_plant"] |= {**pace, "duration": 0.0}
    parameters.make(values)
    return values


def measure(loops: int, args: argparse.Namespace, out: Path | None = None) -> FleetReport:
    """Run a fleet and return what it did once all loops had settled.

    Raises
    ------
    koop_core.errors.LiveError
        If a container ends, or a loop does not begin.
    """
    values = values_of(args)
    with tempfile.TemporaryDirectory() as name:
        folder = out or Path(name)
        with (
            Fleet(folder, loops, values, args.containers, args.pinned) as fleet,
            FleetMonitor() as monitor,
        ):
            monitor.wait_until_running(fleet)
            monitor.listen(SETTLED, fleet.check)
            before, used, begin = monitor.snapshots(fleet), _used(fleet), time.monotonic()
            monitor.listen(args.duration, fleet.check)
            cpu = (_used(fleet) - used) / (time.monotonic() - begin)
            after = monitor.snapshots(fleet)
    return report(before, after, cpu)


def _used(fleet: Fleet) -> float:
    return sum(processor_time(process.process.pid) for process in fleet.processes)
