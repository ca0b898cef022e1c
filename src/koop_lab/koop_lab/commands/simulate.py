"""``koop simulate``: the experiment offline, on the same kernels as the nodes."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from koop_lab.cli.loop_options import add_loop_options, given_values, loop_parameters
from koop_lab.cli.tables import cost_name, metrics_table
from koop_loop.loop import LoopResult, simulate
from koop_loop.metrics import PAPER_DURATION, Metrics
from koop_loop.parameters import LoopParameters
from koop_loop.static_map import performance


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("simulate")
    add_loop_options(parser, duration=PAPER_DURATION)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the run (png, svg, pdf)")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")
    parser.set_defaults(func=main)


def run(parameters: LoopParameters) -> tuple[LoopResult, Metrics]:
    """Run the loop and compute its metrics, with r* from the static map."""
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    steps = round(parameters.pace.duration / parameters.plant.dt)
    result = simulate(parameters.plant, parameters.lifter, parameters.esc, model, steps)
    return result, performance(parameters, model, result.t, result.theta, result.r)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    parameters = loop_parameters(given_values(args))
    cost = cost_name(parameters.lifter.cost, parameters.load_model())
    started = time.perf_counter()
    result, metrics = run(parameters)
    elapsed = time.perf_counter() - started
    if args.plot is not None:
        from koop_lab.plots.signals import COST, plot_signals, true_states  # matplotlib is slow

        plot_signals(
            args.plot,
            result.t,
            true_states(result.ground_truth),
            {COST: result.r},
            {"theta": result.theta},
            f"Offline, {cost} cost, seed {parameters.plant.seed}",
            parameters.plant.theta_star,
        )
    if args.json:
        print(json.dumps(metrics.as_dict(), indent=1))
        return 0
    print(metrics_table(metrics, cost, parameters.pace.duration))
    print(f"{result.theta.size} steps in {elapsed:.2f} s, r* included")
    if args.plot is not None:
        print(f"written to {args.plot}")
    return 0
