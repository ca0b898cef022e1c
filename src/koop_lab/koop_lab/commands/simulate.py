"""``koop simulate``: the experiment offline, on the same kernels as the nodes."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_core.text_table import table
from koop_lab.cli.loop_options import add_loop_options, given_values, loop_parameters
from koop_lab.cli.tables import metrics_table
from koop_loop.loop import LoopResult, simulate
from koop_loop.metrics import LOGGING_START, PAPER_DURATION, Metrics, evaluate
from koop_loop.parameters import LoopParameters
from koop_loop.static_map import performance
from koop_loop.training import STATE_NAMES

SHARES = (0.5, 0.9, 1.0)


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("simulate")
    add_loop_options(parser, duration=PAPER_DURATION)
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N",
        help="N loops, of the plant's seed and the following ones, one after the other",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE.npz", help="write the signals")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the run (png, svg, pdf)")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")
    parser.set_defaults(func=main)


def run(parameters: LoopParameters) -> tuple[LoopResult, Metrics]:
    """Run the loop and compute its metrics, with r* from the static map."""
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    steps = round(parameters.pace.duration / parameters.plant.dt)
    result = simulate(parameters.plant, parameters.lifter, parameters.esc, model, steps)
    return result, performance(parameters, model, result.t, result.theta, result.r)


def run_seeds(parameters: LoopParameters, count: int) -> list[Metrics]:
    """Run loops of ``count`` seeds; return the metrics of each, without e_r^ss.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the seed decides nothing.
    """
    plant = parameters.plant
    if plant.initial_state:
        raise ConfigError("--seeds: the plant's initial_state is given, no seed changes anything")
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    steps = round(parameters.pace.duration / plant.dt)
    metrics = []
    for i in range(count):
        one = replace(plant, seed=plant.seed + i)
        result = simulate(one, parameters.lifter, parameters.esc, model, steps)
        metrics.append(evaluate(result.t, result.theta, result.r, plant.theta_star))
    return metrics


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code."""
    parameters = loop_parameters(given_values(args))
    if args.seeds < 1:
        raise ConfigError(f"--seeds {args.seeds}: must be at least 1")
    if args.seeds > 1:
        return main_of_seeds(args, parameters)
    started = time.perf_counter()
    result, metrics = run(parameters)
    elapsed = time.perf_counter() - started
    if args.out is not None:
        save(args.out, result, parameters)
    if args.plot is not None:
        from koop_lab.plots.signals import plot_signals  # matplotlib is slow to import

        plot_signals(
            args.plot,
            result.t,
            {f"true {name}": x for name, x in zip(STATE_NAMES, result.ground_truth.T, strict=True)},
            {"cost r": result.r},
            {"theta": result.theta},
            f"Offline, {parameters.lifter.cost} cost, seed {parameters.plant.seed}",
            parameters.plant.theta_star,
            LOGGING_START,
        )
    if args.json:
        print(json.dumps(metrics.as_dict(), indent=1))
    else:
        print(metrics_table(metrics, parameters.lifter.cost))
        print(f"{result.theta.size} steps in {elapsed:.2f} s, r* included")
    return 0


def main_of_seeds(args: argparse.Namespace, parameters: LoopParameters) -> int:
    """Run several seeds and print what they have in common; returns the exit code."""
    if args.out is not None or args.plot is not None:
        raise ConfigError("--seeds: --out and --plot are of one loop")
    started = time.perf_counter()
    runs = run_seeds(parameters, args.seeds)
    elapsed = time.perf_counter() - started
    if args.json:
        print(json.dumps([metrics.as_dict() for metrics in runs], indent=1))
        return 0
    rows = [
        [title, *(f"{np.quantile([getattr(m, name) for m in runs], q):.1f}" for q in SHARES)]
        for name, title in (("iae_theta", "IAE_theta [s]"), ("ise_theta", "ISE_theta [s]"))
    ]
    print(table([f"{parameters.lifter.cost} cost", "median", "90 %", "worst"], rows))
    converged = sum(metrics.converged for metrics in runs)
    print(f"{converged} of {len(runs)} converged; {elapsed / len(runs):.2f} s a loop")
    return 0


def save(path: Path, result: LoopResult, parameters: LoopParameters) -> None:
    """Write the signals and the parameters (as JSON text) to an ``.npz`` file."""
    with open(path, "wb") as file:
        np.savez(
            file,
            step=result.step,
            t=result.t,
            x=result.measured,
            ground_truth=result.ground_truth,
            r=result.r,
            theta=result.theta,
            parameters=np.array(json.dumps(parameters.as_ros())),
        )
