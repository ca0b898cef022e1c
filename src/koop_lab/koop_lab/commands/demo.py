"""``koop demo``: the experiment over DDS, the three nodes and the recorder."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

from tqdm import tqdm

from koop_bag.recorder.config import RECORDER, RecorderConfig
from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_bringup.live.served import add_serve_option, served
from koop_core.config.knobs import format_knobs
from koop_core.errors import InputError
from koop_lab.cli.loop_options import add_loop_options, given_values
from koop_lab.cli.loop_options import loop_parameters as finite
from koop_lab.cli.tables import cost_name
from koop_lab.recorded.report import describe, figures, read
from koop_loop import parameters as loop_parameters
from koop_loop.metrics import PAPER_DURATION
from koop_loop.parameters import LoopParameters
from koop_loop.static_map import optimal_cost
from vdp_plant.config import pace_values

BAR = "{desc:<10} {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s{postfix}"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("demo")
    add_loop_options(parser, duration=PAPER_DURATION)
    parser.add_argument(
        "--pace",
        metavar="PACE",
        help="lockstep (default): as fast as the machine allows, and deterministic; realtime; or a "
        "number: so many times real time",
    )
    parser.add_argument(
        "--processes",
        action="store_true",
        help="every node in a process of its own (default: plant, lifter and controller in one, "
        "the recorder in another); the numbers are the same",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the run (default: recordings/TIME-demo)"
    )
    add_serve_option(parser)
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if the loop ran, whether or not it converged."""
    parameters, recorder = read_options(args)
    # a model that cannot be used is said before anything is started
    model = parameters.load_model()
    cost = cost_name(parameters.lifter.cost, model)
    folder = args.out or default_folder("demo")
    # r* needs a kernel of its own, which is compiled beside the nodes' and not after them
    Thread(target=optimal_cost, args=(parameters, model), daemon=True).start()
    print(f"{parameters.pace.duration:g} s of the {cost} cost at pace {parameters.pace.pace}")
    try:
        with served(args.serve, folder / "logs"):
            notes = run_with_progress(folder, parameters, recorder, not args.processes)
    except KeyboardInterrupt:
        if (folder / "bag").is_dir():
            print(f"\nthe run until here is in {folder}/: koop bag metrics and koop replay take it")
        raise
    from koop_lab.plots.signals import COST, plot_signals, true_states  # matplotlib is slow

    theta_star = parameters.plant.theta_star
    # the recorder of a very short run does not know all of these
    run = replace(read(folder), parameters=parameters, theta_star=theta_star, model=model)
    result = {**figures(run), "notes": notes}
    (folder / "metrics.json").write_text(json.dumps(result, indent=1) + "\n")
    signals, truth = run.signals, run.signals.ground_truth
    plot_signals(
        folder / "plot.png",
        signals.t,
        true_states(truth)
        if truth.size
        else dict(zip(signals.names, signals.measured.T, strict=True)),
        {COST: signals.r},
        {"theta": signals.theta},
        f"Over DDS, {cost} cost, seed {parameters.plant.seed}, {parameters.pace.pace} pace",
        theta_star,
    )
    print(describe(run))
    if run.metrics is not None:
        print(
            f"\n{'converged' if run.metrics.converged else 'not converged'}: "
            f"mean |theta - theta*| = {run.metrics.tail_error:.2f} over the last 30 %"
        )
    for note in notes:
        print(f"note: {note}")
    print(f"\nrun folder    {folder}/")
    for name, what in (
        ("plot.png", "state, cost and theta, as in the paper's figures"),
        ("bag/", "all topics, for any MCAP reader"),
        ("metrics.json", "the figures above"),
        ("parameters.yaml", "of every node; feeds --params-file"),
    ):
        print(f"  {name:<16}{what}")
    return 0


def read_options(args: argparse.Namespace) -> tuple[LoopParameters, RecorderConfig]:
    """Return the parameters that the options and the parameter file describe.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If one cannot be used.
    """
    values = given_values(args, {**loop_parameters.NODES, **RECORDER})
    if args.pace is not None:
        values["vdp_plant"] |= pace_values(args.pace)
    values["vdp_plant"].setdefault("pace", "lockstep")
    recorder = loop_parameters.build({"recorder": values.pop("recorder", {})}, RECORDER)
    return finite(values), recorder["recorder"][RecorderConfig]


def run_with_progress(
    folder: Path, parameters: LoopParameters, recorder: RecorderConfig, composed: bool
) -> list[str]:
    """Run the live loop with a progress bar; return what a reader of the results should know."""
    if (folder / "bag").exists():
        raise InputError(f"{folder} holds a recording already: choose another --out")
    dt = parameters.plant.dt
    steps = round(parameters.pace.duration / dt)
    with (
        tqdm(total=steps * dt, unit="s", desc="connecting", bar_format=BAR, disable=None) as bar,
        LiveLoop(folder, parameters, recorder, composed) as loop,
    ):

        def show(progress: Progress) -> None:
            if progress.step == 0:
                bar.refresh()
                return
            bar.set_description_str("damping", refresh=False)
            bar.n = round(progress.step * dt, 1)
            bar.set_postfix_str(
                f"θ = {format_knobs(progress.theta, '+.2f')}, r = {progress.r:.3g}, "
                f"{progress.steps_per_second * dt:.1f} x real time"
            )

        loop.run(show)
        bar.n = steps * dt
        bar.set_description_str("done")
        bar.refresh()
    return loop.notes
