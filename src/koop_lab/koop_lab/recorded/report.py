"""``koop bag metrics`` and ``koop bag plot``: what a recorded run says."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from koop_bag.bag.reader import BagReader
from koop_lab.cli.table import metrics_table, table
from koop_lab.recorded.run import RecordedRun, read_run
from koop_lab.replay.recording import read_recording
from koop_lab.replay.settings import Models, known_parameters, recorded_values
from koop_loop.metrics import Metrics, evaluate
from koop_loop.parameters import NODES, LoopParameters, make
from koop_loop.static_map import performance
from koopman_lifter.model import KoopmanModel


@dataclass(frozen=True)
class Run:
    """A recorded run and what the bag says about how it was made.

    Attributes
    ----------
    signals : RecordedRun
        State, cost, theta.
    dt : float
        Time between two steps [s].
    parameters : LoopParameters or None
        Of the loop; None if they were not recorded.
    simulated : bool
        Whether the plant was ours, so that its theta* is known.
    model : KoopmanModel or None
        Model of the first cost; None if it is not at hand.
    """

    signals: RecordedRun
    dt: float
    parameters: LoopParameters | None
    simulated: bool
    model: KoopmanModel | None


def read(path: Path, namespace: str = "/", model: Path | None = None) -> Run:
    """Read a run.

    Parameters
    ----------
    path : Path
        Folder of a run or of a bag, or an `.mcap` file.
    namespace : str
        Namespace of the loop.
    model : Path, optional
        Model file, if it is not in the run's folder.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    ValueError
        If it does not hold a closed loop.
    """
    signals = read_run(path, namespace)
    with BagReader(path) as bag:
        values = recorded_values(bag, path, namespace, NODES)
    known = {
        node: {k: v for k, v in given.items() if k in known_parameters(node)}
        for node, given in values.items()
    }
    parameters = make(known) if known else None
    wanted = read_recording(path, namespace).first_model
    named = str(known.get("koopman_lifter", {}).get("model", ""))
    try:
        found = Models(path, named, str(model or "")).load(wanted) if wanted else None
    except ValueError:
        found = None
    dt = parameters.lifter.dt if parameters else _measured_dt(signals)
    return Run(signals, dt, parameters, "vdp_plant" in known, found)


def _measured_dt(signals: RecordedRun) -> float:
    """Return the usual time between two states as they were received [s]."""
    return float(np.median(np.diff(signals.state_time)))


def metrics_of(run: Run, theta_star: float | None = None) -> Metrics | None:
    """Return the paper's metrics; None if nothing says what theta* is."""
    signals, parameters = run.signals, run.parameters
    t = signals.t(run.dt)
    if run.simulated and parameters is not None:
        lifted = parameters.lifter.cost == "lifted"
        if theta_star in (None, parameters.plant.theta_star) and (run.model or not lifted):
            model = run.model if lifted else None
            return performance(parameters, model, t, signals.theta, signals.r)
        theta_star = parameters.plant.theta_star if theta_star is None else theta_star
    if theta_star is None:
        return None
    return evaluate(t, signals.theta, signals.r, theta_star)


def signal_table(run: Run) -> str:
    """Return mean, deviation and range of every signal over the last 30 % of the run."""
    signals = run.signals
    tail = slice(-max(1, round(0.3 * signals.step.size)), None)
    columns = [(f"x[{i}]", column) for i, column in enumerate(signals.measured.T)]
    rows = []
    for name, values in (*columns, ("r", signals.r), ("theta", signals.theta)):
        part = values[tail][np.isfinite(values[tail])]
        if part.size:
            shown = (part.mean(), part.std(), part.min(), part.max())
            rows.append([name, *(f"{value:.6g}" for value in shown)])
    return table(["last 30 %", "mean", "deviation", "least", "largest"], rows)


def metrics_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop bag metrics``; returns the exit code."""
    run = read(args.run, args.namespace, args.model)
    metrics, signals = metrics_of(run, args.theta_star), run.signals
    if args.json:
        result = {
            **(metrics.as_dict() if metrics else {}),
            "steps": signals.counts["state"],
            "rate_hz": _rate(signals),
            "lost": signals.lost,
        }
        print(json.dumps(result, indent=1))
        return 0
    if metrics is not None:
        cost = run.parameters.lifter.cost if run.parameters else "lifted"
        print(metrics_table(metrics, cost) + "\n")
    else:
        print("the best theta is not in the bag: --theta-star adds the paper's metrics\n")
    print(signal_table(run))
    lost = ", ".join(f"{count} on {topic}" for topic, count in signals.lost.items() if count)
    print(f"\n{signals.counts['state']} states, {_rate(signals):.1f} /s; lost: {lost or 'none'}")
    _say_passes(signals)
    return 0


def _say_passes(signals: RecordedRun) -> None:
    if signals.passes > 1:
        end = signals.step[-1]
        print(f"the steps begin {signals.passes} times: this is the longest run, to step {end}")


def _rate(signals: RecordedRun) -> float:
    """Return the states received per second of wall-clock time."""
    return (signals.counts["state"] - 1) / signals.duration if signals.duration > 0.0 else 0.0


def plot_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop bag plot``; returns the exit code."""
    from koop_lab.plots.report import plot_report  # matplotlib takes half a second to import

    run = read(args.run, args.namespace, args.model)
    folder = args.run if args.run.is_dir() else args.run.parent
    out = args.out or folder / "report.png"
    theta_star = args.theta_star
    if theta_star is None and run.simulated and run.parameters is not None:
        theta_star = run.parameters.plant.theta_star
    plot_report(out, run.signals, run.dt, run.model, theta_star, f"{args.run}")
    print(f"written to {out}")
    _say_passes(run.signals)
    return 0
