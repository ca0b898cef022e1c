"""``koop demo``: the experiment over DDS, the three nodes and the recorder."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from tqdm import tqdm

from koop_bag.recorder.config import RECORDER, RecorderConfig
from koop_bag.recorder.run_folder import default_folder
from koop_bringup.live.loop import LiveLoop
from koop_bringup.live.monitor import Progress
from koop_bringup.live.served import add_serve_option, served
from koop_core.errors import InputError
from koop_identify.recording.loop import LoopRecord
from koop_identify.recording.signals import loop_signals
from koop_lab.cli.loop_options import add_loop_options, given_values
from koop_lab.cli.loop_options import loop_parameters as finite
from koop_lab.cli.tables import metrics_table, rig_table
from koop_lab.recorded.report import rig_metrics_of
from koop_loop import parameters as loop_parameters
from koop_loop.metrics import LOGGING_START, PAPER_DURATION, Metrics
from koop_loop.parameters import LoopParameters
from koop_loop.static_map import performance
from koop_loop.training import STATE_NAMES
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
    parameters.load_model()  # one that cannot be used is said before anything is started
    folder = args.out or default_folder("demo")
    nodes = "plant, lifter and controller in one process, and recorder"
    if args.processes:
        nodes = "plant, lifter, controller and recorder, a process each"
    print(
        f"{parameters.pace.duration:g} s of the {parameters.lifter.cost} cost at pace "
        f"{parameters.pace.pace}: {nodes}"
    )
    with served(args.serve, folder / "logs"):
        wall, notes = run_with_progress(folder, parameters, recorder, composed=not args.processes)
    dt = parameters.plant.dt
    record, signals = loop_signals(folder / "bag", "/", dt)
    run = record.closed(folder)
    rig, names = rig_metrics_of(signals)
    metrics = write_results(folder, parameters, run, rig.as_dict(names), wall, notes)
    print(metrics_table(metrics, parameters.lifter.cost))
    if parameters.pace.duration != PAPER_DURATION:
        print(f"(the paper's figures are those of {PAPER_DURATION:g} s)")
    print("\n" + rig_table(rig, names))
    rate = (run.counts["state"] - 1) / run.duration
    print(
        f"\n{'converged' if metrics.converged else 'not converged'}: "
        f"mean |theta - theta*| = {metrics.tail_error:.2f} over the last 30 %\n"
        f"{rate:.0f} steps a second, {rate * dt:.1f} x real time; lost messages: "
        + (", ".join(f"{n} on {t}" for t, n in run.lost.items() if n) or "none")
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
    folder: Path,
    parameters: LoopParameters,
    recorder: RecorderConfig = RecorderConfig(),  # noqa: B008 - it is frozen
    composed: bool = False,
) -> tuple[float, list[str]]:
    """Run the live loop, its nodes in one process if composed, with a progress bar.

    Returns
    -------
    wall : float
        Wall-clock time of the whole run [s].
    notes : list of str
        What a reader of the results should know.
    """
    if (folder / "bag").exists():
        raise InputError(f"{folder} holds a recording already: choose another --out")
    dt = parameters.plant.dt
    steps = round(parameters.pace.duration / dt)
    started = time.monotonic()
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
                f"θ = {progress.theta:+.2f}, r = {progress.r:.3g}, "
                f"{progress.steps_per_second * dt:.1f} x real time"
            )

        loop.run(show)
        bar.n = steps * dt
        bar.set_description_str("done")
        bar.refresh()
    return time.monotonic() - started, loop.notes


def write_results(
    folder: Path,
    parameters: LoopParameters,
    run: LoopRecord,
    rig: dict[str, Any],
    wall: float,
    notes: list[str],
) -> Metrics:
    """Write metrics.json and plot.png of a recorded run."""
    from koop_lab.plots.signals import plot_signals  # matplotlib is slow to import

    dt = parameters.plant.dt
    t = run.t(dt)
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    metrics = performance(parameters, model, t, run.theta, run.r)
    rate = (run.counts["state"] - 1) / run.duration
    result = {
        **metrics.as_dict(),
        **rig,
        "rate_hz": rate,
        "real_time_factor": rate * dt,
        "wall_time": wall,
        "steps": run.counts["state"],
        "lost": run.lost,
        "notes": notes,
    }
    (folder / "metrics.json").write_text(json.dumps(result, indent=1) + "\n")
    known = bool(run.ground_truth.shape[1])
    states = run.ground_truth if known else run.measured
    names = [f"true {name}" if known else name for name in STATE_NAMES]
    plot_signals(
        folder / "plot.png",
        t,
        dict(zip(names, states.T, strict=True)),
        {"cost r": run.r},
        {"theta": run.theta},
        f"Over DDS, {parameters.lifter.cost} cost, seed {parameters.plant.seed}, "
        f"{parameters.pace.pace} pace",
        parameters.plant.theta_star,
        LOGGING_START,
    )
    return metrics
