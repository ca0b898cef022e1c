"""``koop demo``: the experiment over DDS, three node processes and the recorder."""

from __future__ import annotations

import argparse
import json
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from tqdm import tqdm

from koop_lab.cli.options import add_loop_options
from koop_lab.cli.options import loop_parameters as parameters_from
from koop_lab.cli.table import metrics_table
from koop_lab.live.loop import LiveLoop, Progress
from koop_lab.recorded.run import RecordedRun, read_run
from koop_loop import parameters as loop_parameters
from koop_loop.metrics import PAPER_DURATION, Metrics
from koop_loop.parameters import LoopParameters
from koop_loop.static_map import performance

BAR = "{desc:<10} {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s{postfix}"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser("demo")
    add_loop_options(parser, duration=PAPER_DURATION)
    parser.add_argument(
        "--pace",
        choices=("lockstep", "realtime", "scaled"),
        default="lockstep",
        help="lockstep (default): as fast as the machine allows, and deterministic",
    )
    parser.add_argument(
        "--time-scale", type=float, metavar="F", help="with --pace scaled: simulated per real time"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the run (default: recordings/TIME-demo)"
    )
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 if the loop ran, whether or not it converged."""
    parameters = with_pace(parameters_from(args), args.pace, args.time_scale)
    parameters.load_model()  # one that cannot be used is said before anything is started
    folder = args.out or default_folder("demo")
    print(
        f"{parameters.pace.duration:g} s of the {parameters.lifter.cost} cost at pace "
        f"{parameters.pace.pace}: plant, lifter, controller and recorder"
    )
    wall = run_with_progress(folder, parameters)
    run = read_run(folder / "bag")
    metrics = write_results(folder, parameters, run, wall)
    print(metrics_table(metrics, parameters.lifter.cost))
    if parameters.pace.duration != PAPER_DURATION:
        print(f"(the paper's figures are those of {PAPER_DURATION:g} s)")
    dt = parameters.plant.dt
    rate = (run.counts["state"] - 1) / run.duration
    print(
        f"\n{'converged' if metrics.converged else 'not converged'}: "
        f"mean |theta - theta*| = {metrics.tail_error:.2f} over the last 30 %\n"
        f"{rate:.0f} steps a second, {rate * dt:.1f} x real time; lost messages: "
        + (", ".join(f"{n} on {t}" for t, n in run.lost.items() if n) or "none")
    )
    print(f"\nrun folder    {folder}/")
    for name, what in (
        ("plot.png", "state, cost and theta, as in the paper's figures"),
        ("bag/", "all topics, for any MCAP reader"),
        ("metrics.json", "the figures above"),
        ("parameters.yaml", "of every node; feeds --params-file"),
    ):
        print(f"  {name:<16}{what}")
    return 0


def with_pace(parameters: LoopParameters, pace: str, time_scale: float | None) -> LoopParameters:
    """Return the parameters at another pace.

    Raises
    ------
    ValueError
        If a time scale is given for a pace that has none.
    """
    if time_scale is not None and pace != "scaled":
        raise ValueError("--time-scale needs --pace scaled")
    values = loop_parameters.changed(
        parameters.as_ros(), ("vdp_plant", "pace", pace), ("vdp_plant", "time_scale", time_scale)
    )
    return loop_parameters.make(values)


def default_folder(label: str) -> Path:
    """Return a new run folder under recordings/, named after the time."""
    stamp = datetime.now(timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    return Path("recordings") / f"{stamp}-{label}"


def run_with_progress(folder: Path, parameters: LoopParameters) -> float:
    """Run the live loop with a progress bar; return the wall-clock time of the whole run [s]."""
    if (folder / "bag").exists():
        raise ValueError(f"{folder} holds a recording already: choose another --out")
    dt = parameters.plant.dt
    steps = round(parameters.pace.duration / dt)
    started = time.monotonic()
    with (
        tqdm(total=steps * dt, unit="s", desc="connecting", bar_format=BAR, disable=None) as bar,
        LiveLoop(folder, parameters) as loop,
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
    return time.monotonic() - started


def write_results(
    folder: Path, parameters: LoopParameters, run: RecordedRun, wall: float
) -> Metrics:
    """Write metrics.json and plot.png of a recorded run."""
    from koop_lab.plots.paper import plot_run  # matplotlib takes half a second to import

    dt = parameters.plant.dt
    t = run.t(dt)
    model = parameters.load_model() if parameters.lifter.cost == "lifted" else None
    metrics = performance(parameters, model, t, run.theta, run.r)
    rate = (run.counts["state"] - 1) / run.duration
    result = {
        **metrics.as_dict(),
        "rate_hz": rate,
        "real_time_factor": rate * dt,
        "wall_time": wall,
        "steps": run.counts["state"],
        "lost": run.lost,
    }
    (folder / "metrics.json").write_text(json.dumps(result, indent=1) + "\n")
    plot_run(
        folder / "plot.png",
        t,
        run.ground_truth if run.ground_truth.shape[1] else run.measured,
        run.r,
        run.theta,
        parameters.plant.theta_star,
        f"Over DDS, {parameters.lifter.cost} cost, seed {parameters.plant.seed}, "
        f"{parameters.pace.pace} pace",
    )
    return metrics
