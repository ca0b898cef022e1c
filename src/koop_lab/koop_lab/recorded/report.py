"""``koop bag metrics`` and ``koop bag plot``: what a recorded run says."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_core.errors import InputError, KoopError
from koop_identify.recording.loop import LoopRecord
from koop_identify.recording.recorded_parameters import Models, known_parameters, recorded_values
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.signals import Signals, loop_signals, read_signals
from koop_lab.cli.source_options import reading_of
from koop_lab.cli.tables import metrics_table, rig_table
from koop_loop.metrics import LOGGING_START, TOLERANCE, Metrics, evaluate
from koop_loop.parameters import NODES, LoopParameters, make, with_model_beside
from koop_loop.rig_metrics import RigMetrics, rig_metrics
from koop_loop.static_map import performance
from koopman_lifter.model import KoopmanModel, load

WHOLE = 0.99  # of the recorded time: figures that cover less say so


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run and what the bag says about how it was made.

    Attributes
    ----------
    path : Path
        The bag.
    signals : Signals
        State, cost, theta.
    loop : LoopRecord or None
        The loop's own topics; None of a bag of other messages.
    parameters : LoopParameters or None
        Of the loop; None if they were not recorded.
    simulated : bool
        Whether the plant was ours, so that its theta* is known.
    model : KoopmanModel or None
        The given one, else that of the first cost; None if it is not at hand.
    """

    path: Path
    signals: Signals
    loop: LoopRecord | None
    parameters: LoopParameters | None
    simulated: bool
    model: KoopmanModel | None

    @property
    def theta_star(self) -> float | None:
        """The best theta of our plant; None of a rig."""
        return self.parameters.plant.theta_star if self.simulated and self.parameters else None


def read(
    path: Path,
    reading: BagReading | None = None,
    namespace: str = "/",
    model: Path | None = None,
    dt: float | None = None,
) -> RecordedRun:
    """Read a run, or a bag of any messages.

    Parameters
    ----------
    path : Path
        Folder of a run or of a bag, or an `.mcap` file.
    reading : BagReading, optional
        What is measured and commanded; None: the loop's own topics.
    namespace : str
        Of the loop, where its own topics are read.
    model : Path, optional
        Model file, if it is not in the run's folder.
    dt : float, optional
        Time between two states of the loop [s]; None: as the bag says.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    koop_core.errors.InputError
        If there is no state in it, or the model file cannot be used.
    """
    given = load(model) if model is not None else None
    if reading is not None:
        signals = read_signals(path, reading, given.dt if given else None)
        return RecordedRun(path, signals, None, None, False, given)
    with BagReader(path) as bag:
        values = recorded_values(bag, path, namespace, NODES)
    recorded = {
        node: {k: v for k, v in section.items() if k in known_parameters(node)}
        for node, section in values.items()
    }
    parameters = make(recorded) if recorded else None
    dt = dt or (parameters.lifter.dt if parameters else given.dt if given else None)
    loop, signals = loop_signals(path, namespace, dt, given.state_names if given else None)
    used = given
    if used is None and (model_id := loop.model_id):
        named = str(recorded.get("koopman_lifter", {}).get("model", ""))
        try:
            used = Models(path, named).load(model_id)
        except InputError:
            used = None
    return RecordedRun(path, signals, loop, parameters, "vdp_plant" in recorded, used)


def metrics_of(
    run: RecordedRun, theta_star: float | None, start: float, tolerance: float
) -> Metrics | None:
    """Return the paper's metrics; None if theta* is not known, or no theta was recorded."""
    signals, parameters = run.signals, run.parameters
    if theta_star is None or not signals.has_theta:
        return None
    if run.loop is None or not run.loop.counts.get("cost"):
        rows = np.isfinite(signals.theta)
        t, theta, r = (x[rows] for x in (signals.t, signals.theta, signals.r))
        return evaluate(t, theta, r, theta_star, None, start, tolerance)
    closed = run.loop.closed(run.path)
    t, theta, r = closed.t(signals.dt), closed.theta, closed.r
    if parameters is not None and theta_star == run.theta_star:  # r* belongs to the plant's own
        lifted = parameters.lifter.cost == "lifted"
        if run.model or not lifted:
            model = run.model if lifted else None
            return performance(parameters, model, t, theta, r, start, tolerance)
    return evaluate(t, theta, r, theta_star, None, start, tolerance)


def rig_metrics_of(
    signals: Signals, start: float | None = None
) -> tuple[RigMetrics, tuple[str, ...]]:
    """Return the metrics that need no theta*, and the names of their channels."""
    true = tuple(f"true {i}" for i in range(signals.ground_truth.shape[1]))
    if len(true) == len(signals.names):
        true = tuple(f"true {name}" for name in signals.names)
    channels = np.hstack((signals.x, signals.ground_truth))
    theta = signals.theta if signals.has_theta else None
    metrics = rig_metrics(signals.t, channels, theta, signals.limited, start)
    return metrics, signals.names + true


def coverage(run: RecordedRun) -> dict[str, Any]:
    """Return how much of the recorded time the figures cover, in JSON terms."""
    signals = run.signals
    return {
        "covered": signals.covered,
        "recorded": signals.recorded,
        "whole": bool(signals.covered >= WHOLE * signals.recorded - signals.dt),
        "runs": run.loop.passes if run.loop else 1,
    }


def describe_coverage(run: RecordedRun) -> str:
    """Return in words how much of the recorded time the figures cover, and why not all of it."""
    covers, signals = coverage(run), run.signals
    lines = [
        f"the figures cover {covers['covered']:.6g} of {covers['recorded']:.6g} s"
        + ("" if covers["whole"] else " ONLY")
    ]
    has_theta = np.isfinite(signals.theta)
    if signals.has_theta and not has_theta.all():
        lines.append(
            f"theta is missing for {np.count_nonzero(~has_theta)} of {has_theta.size} states; it "
            f"is there from {signals.t[has_theta][0]:.6g} to {signals.t[has_theta][-1]:.6g} s"
        )
    if run.loop is not None and run.loop.passes > 1:
        lines.append(
            f"the steps begin {run.loop.passes} times: this is the longest run, to step "
            f"{run.loop.step[-1]}"
        )
    return "\n".join(lines)


def run_figures(folder: Path, namespace: str) -> str:
    """Return what a run achieved in words, for its end; or why that is not known."""
    try:
        run = read(folder, namespace=namespace or "/")
        rig, names = rig_metrics_of(run.signals)
    except KoopError as error:
        return f"no figures of the run: {error}"
    return f"{rig_table(rig, names)}\n{describe_coverage(run)}"


def metrics_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop bag metrics``; returns the exit code."""
    run = read(args.run, reading_of(args), args.namespace, args.model, args.dt)
    signals, loop = run.signals, run.loop
    cost = run.parameters.lifter.cost if run.parameters else "lifted"
    theta_star = run.theta_star if args.theta_star is None else args.theta_star
    start = LOGGING_START if args.start is None else args.start
    tolerance = TOLERANCE if args.tolerance is None else args.tolerance
    metrics = metrics_of(run, theta_star, start, tolerance)
    rig, names = rig_metrics_of(signals, args.start)
    rate = 0.0
    if loop is not None and loop.duration > 0.0:
        rate = (loop.counts["state"] - 1) / loop.duration
    if args.json:
        figures: dict[str, Any] = {"steps": int(signals.t.size), "dt": signals.dt}
        if loop is not None:
            figures |= {"steps": loop.counts["state"], "rate_hz": rate, "lost": loop.lost}
        if metrics is not None:
            start = start if signals.t[-1] > start else float(signals.t[0])
            figures |= {**metrics.as_dict(), "cost": cost, "theta_star": theta_star}
            figures |= {"tolerance": tolerance, "start": start}
        figures |= {**rig.as_dict(names), "coverage": coverage(run), "way": signals.way}
        print(json.dumps(figures, indent=1))
        return 0
    if metrics is not None:
        print(metrics_table(metrics, cost, run.simulated) + "\n")
    print(rig_table(rig, names) + "\n")
    if loop is not None:
        lost = ", ".join(f"{count} on {topic}" for topic, count in loop.lost.items() if count)
        print(f"{loop.counts['state']} states, {rate:.1f} /s; lost: {lost or 'none'}")
    else:
        print(f"{signals.t.size} states, one each {signals.dt:g} s ({signals.way})")
    print(describe_coverage(run))
    return 0


def plot_main(args: argparse.Namespace) -> int:
    """Entry point of ``koop bag plot``; returns the exit code."""
    # matplotlib takes half a second to import
    from koop_lab.plots.report import plot_report

    run = read(args.run, reading_of(args), args.namespace, args.model, args.dt)
    costs = costs_of(run, args.model)
    folder = args.run if args.run.is_dir() else args.run.parent
    out = args.out or folder / "report.png"
    plot_report(out, run.signals, costs, run.model, run.theta_star, f"{args.run}")
    print(f"written to {out}")
    print(describe_coverage(run))
    return 0


def costs_of(run: RecordedRun, model: Path | None = None) -> dict[str, NDArray[np.float64]]:
    """Return the costs of a run by name: as computed, and as recorded.

    One is computed where a model is given or none was recorded; without a model it is raw.
    """
    from koop_lab.replay import open_loop

    costs = {"recorded r": run.signals.r} if run.signals.has_r else {}
    if costs and model is None:
        return costs
    recorded = run.parameters.as_ros() if run.parameters is not None else {}
    for folder in (run.path.parent, run.path):  # of a bag in its run, or of the run
        recorded = with_model_beside(folder / "parameters.yaml", recorded)
    file = str(model) if model else None
    parameters = open_loop.settings(
        run.signals.dt, file, recorded=recorded, lifted=run.model is not None
    )
    r = open_loop.answer(run.signals, parameters, f"the state in {run.path}").r
    lifted = parameters.lifter.cost == "lifted" and run.model is not None
    name = f"r under {run.model.model_id}" if lifted and run.model else "raw r"
    return {name: r, **costs}
