"""``koop bench realtime``: does the loop keep 200 Hz, and how evenly?"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_lab.live.demo import run_with_progress
from koop_lab.recorded.run import read_run
from koop_loop.parameters import make

EDGES = np.array([0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, np.inf])  # [ms] off the nominal period


def register(benchmarks: Any) -> None:
    """Add the benchmark to the subparsers of ``koop bench``."""
    parser = benchmarks.add_parser("realtime", help="count, losses and jitter at 200 Hz")
    parser.add_argument("--duration", type=float, default=60.0, metavar="S")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    parameters = make({"vdp_plant": {"duration": args.duration, "pace": "realtime"}})
    dt = parameters.plant.dt
    with tempfile.TemporaryDirectory() as folder:
        run_with_progress(Path(folder), parameters)
        run = read_run(Path(folder) / "bag")
    expected = run.duration / dt + 1
    print(
        f"states: {run.counts['state']} in {run.duration:.3f} s, {expected:.1f} expected at "
        f"{1 / dt:g} Hz"
    )
    print("lost by step: " + ", ".join(f"{topic} {count}" for topic, count in run.lost.items()))
    print(histogram(np.diff(run.state_time) - dt))
    return 0


def histogram(deviation: NDArray[np.float64]) -> str:
    """Return the distribution of |interval - dt|, given in seconds, as text."""
    off = np.abs(deviation) * 1e3
    counts, _ = np.histogram(off, EDGES)
    lines = ["|interval - dt| between states as received [ms]"]
    for low, high, count in zip(EDGES, EDGES[1:], counts, strict=False):
        share = count / off.size
        label = f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}"
        lines.append(f"  {label:<12}{count:>8}  {share:6.1%}  {'#' * round(50 * share)}")
    lines.append(
        f"median {np.median(off):.3f}, 99 % {np.quantile(off, 0.99):.3f}, max {off.max():.3f} ms"
    )
    return "\n".join(lines)
