"""``koop bench``: measurements that print ratios against a baseline of the same run."""

from __future__ import annotations

from typing import Any

from koop_bench import (
    bags,
    everything,
    fleet,
    identify,
    loop,
    memory,
    offline,
    realtime,
    record,
    serve,
    start,
    training,
)

BENCHMARKS = (
    bags, fleet, identify, loop, memory, offline, realtime, record, serve, start, training,
)  # fmt: skip


def register(commands: Any) -> None:
    """Add the command, with one subcommand a benchmark, to the subparsers of ``koop``."""
    parser = commands.add_parser("bench")
    benchmarks = parser.add_subparsers(dest="benchmark", metavar="BENCHMARK", required=True)
    for module in (*BENCHMARKS, everything):
        module.register(benchmarks)
