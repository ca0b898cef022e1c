"""A recorded run: its figures, in words and in JSON terms, and its costs."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_core.config.fields import Source, parse_sources
from koop_core.errors import InputError
from koop_identify.recording.loop import LoopRecord, Trips, read_loop
from koop_identify.recording.recorded_parameters import Models, recorded_values
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.signals import Signals, read_signals
from koop_lab.cli.tables import cost_name, metrics_table, rig_table
from koop_lab.replay.answers import ReplayedLoop
from koop_loop.metrics import Metrics, evaluate
from koop_loop.parameters import NODES, LoopParameters, make, names_of
from koop_loop.rig_metrics import RigMetrics, rig_metrics
from koop_loop.static_map import performance
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel, load, load_fitting
from relay_esc.config import EscConfig

WHOLE = 0.99  # of the recorded time: figures that cover less say so


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run and what the bag says about how it was made."""

    path: Path
    """The bag."""
    signals: Signals
    """State, cost, theta."""
    loop: LoopRecord | None
    """The loop's own topics; None of a bag of other messages."""
    parameters: LoopParameters | None
    """Parameters of the loop; None if they were not recorded."""
    theta_star: float | tuple[float, ...] | None
    """The best theta of our plant; None of a rig."""
    model: KoopmanModel | None
    """The chosen model, else the model of the first cost; None if it is not at hand."""

    @property
    def cost(self) -> str:
        """Name of the cost that was answered."""
        return cost_name(self.parameters.lifter.cost, self.model) if self.parameters else "lifted"

    @cached_property
    def metrics(self) -> Metrics | None:
        """The paper's metrics of a run of our plant; None of any other."""
        parameters, loop, theta_star = self.parameters, self.loop, self.theta_star
        if parameters is None or loop is None or theta_star is None:
            return None
        if not (self.signals.has_theta and loop.counts.get("cost")):
            return None
        closed = loop.closed(self.path)
        t, theta, r = closed.t, closed.theta, closed.r
        lifted = parameters.lifter.cost == "lifted"
        if lifted and self.model is None:  # without it r* is not known
            return evaluate(t, theta, r, theta_star)
        return performance(parameters, self.model if lifted else None, t, theta, r)

    @property
    def rate(self) -> float:
        """States a second of wall-clock time; 0 of a bag of other messages."""
        loop = self.loop
        return (loop.counts["state"] - 1) / loop.duration if loop and loop.duration > 0.0 else 0.0


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
        Namespace of the loop, where its own topics are read.
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
    chosen = load(model) if model is not None else None
    if reading is not None:
        signals = read_signals(path, reading, chosen.dt if chosen else None)
        return RecordedRun(path, signals, None, None, None, chosen)
    with BagReader(path) as bag:
        values = recorded_values(bag, namespace, (*NODES, "koop_guard"))
    guard = values.pop("koop_guard", {})
    commands = _commanded(guard["command"], namespace) if guard else []
    recorded = {
        node: {k: v for k, v in section.items() if k in names_of(NODES[node])}
        for node, section in values.items()
    }
    parameters = make(recorded) if recorded else None
    dt = dt or (parameters.lifter.dt if parameters else chosen.dt if chosen else None)
    loop = read_loop(path, namespace, commands, dt, chosen.state_names if chosen else ())
    used = chosen
    if used is None and loop.model_id:
        named = str(recorded.get("koopman_lifter", {}).get("model", ""))
        with suppress(InputError):  # it is not at hand
            used = load(Models(path, named).file(loop.model_id))
    theta_star = parameters.plant.theta_star if parameters and "vdp_plant" in recorded else None
    return RecordedRun(path, loop, loop, parameters, theta_star, used)


def _commanded(text: str, namespace: str) -> list[Source]:
    """Return what the guard of a namespace commanded; its topics by their full names."""
    base = namespace.rstrip("/") + "/"
    return [
        c if c.topic.startswith("/") else c._replace(topic=base + c.topic)
        for c in parse_sources(text)
    ]


def rig_metrics_of(run: RecordedRun) -> tuple[RigMetrics, tuple[str, ...]]:
    """Return the metrics that need no theta*, and the names of their channels.

    What was measured while the guard held theta, tripped, is not the loop's.
    """
    signals = run.signals
    true = tuple(f"true {name}" for name in signals.names)
    true = true if signals.ground_truth.shape[1] == len(true) else ()
    channels = np.hstack((signals.measured, signals.ground_truth[:, : len(true)]))
    theta = signals.theta.copy() if signals.has_theta else None
    if run.loop is not None:
        channels[run.loop.tripped] = np.nan
        if theta is not None:
            theta[run.loop.tripped] = np.nan
    metrics = rig_metrics(signals.t, channels, theta, signals.limited)
    return metrics, signals.names + true


def figures(run: RecordedRun) -> dict[str, Any]:
    """Return all figures of a run, in JSON terms."""
    signals, loop, metrics = run.signals, run.loop, run.metrics
    rig, names = rig_metrics_of(run)
    result: dict[str, Any] = {"steps": int(signals.t.size), "dt": signals.dt}
    if loop is not None:
        result |= {"steps": loop.counts["state"], "lost": loop.lost}
        result |= {"rate_hz": run.rate, "real_time_factor": run.rate * signals.dt}
    if metrics is not None:
        result |= {**metrics.as_dict(), "cost": run.cost, "theta_star": run.theta_star}
    coverage = {
        "covered": signals.covered,
        "recorded": signals.recorded,
        "whole": _is_whole(signals),
        "runs": loop.passes if loop else 1,
    }
    return {**result, **rig.as_dict(names), "coverage": coverage, "way": signals.way}


def describe(run: RecordedRun) -> str:
    """Return in words and tables what a run achieved."""
    signals, loop, metrics = run.signals, run.loop, run.metrics
    rig, names = rig_metrics_of(run)
    duration = float(signals.t[-1] - signals.t[0]) + signals.dt
    lines = [metrics_table(metrics, run.cost, duration), ""] if metrics is not None else []
    if loop is not None and loop.trips is not None:
        lines += [describe_trips(loop.trips), ""]
    grows = run.parameters is not None and run.parameters.esc.objective == "maximise"
    lines += [rig_table(rig, names, grows), ""]
    if loop is not None:
        lost = ", ".join(f"{count} on {topic}" for topic, count in loop.lost.items() if count)
        lines.append(
            f"{loop.counts['state']} states, {run.rate:.1f} /s, {run.rate * signals.dt:.1f} x real "
            f"time; lost: {lost or 'none'}"
        )
    else:
        lines.append(f"{signals.t.size} states, one each {signals.dt:g} s ({signals.way})")
    return "\n".join([*lines, describe_coverage(run)])


def describe_trips(trips: Trips) -> str:
    """Return in words how often the guard tripped, why, and whether it was rearmed."""
    when, rearmed = (
        time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at)) if np.isfinite(at) else ""
        for at in (trips.when, trips.rearmed)
    )
    often = "" if trips.times == 1 else f" {trips.times} times, last"
    left = f"rearmed at {rearmed}" if rearmed else "still tripped at the end"
    return (
        f"the guard tripped{often} at {when}: {trips.reason}; {left}\n"
        "what was measured while it was tripped is left out below"
    )


def describe_coverage(run: RecordedRun) -> str:
    """Return in words how much of the recorded time the figures cover, and why not all of it."""
    signals, loop = run.signals, run.loop
    lines = [
        f"the figures cover {signals.covered:.6g} of {signals.recorded:.6g} s"
        + ("" if _is_whole(signals) else " only")
    ]
    has_theta = signals.theta_known
    if signals.has_theta and not has_theta.all():
        lines.append(
            f"theta is missing for {np.count_nonzero(~has_theta)} of {has_theta.size} states; it "
            f"is there from {signals.t[has_theta][0]:.6g} to {signals.t[has_theta][-1]:.6g} s"
        )
    if loop is not None and loop.passes > 1:
        lines.append(
            f"the steps begin {loop.passes} times: this is the longest run, to step {loop.step[-1]}"
        )
    return "\n".join(lines)


def _is_whole(signals: Signals) -> bool:
    return bool(signals.covered >= WHOLE * signals.recorded - signals.dt)


def costs_of(run: RecordedRun, model: Path | None = None) -> dict[str, NDArray[np.float64]]:
    """Return the costs of a run by name: as computed, and as recorded.

    One is computed where a model is given or none was recorded; without a model it is raw.
    """
    signals, parameters = run.signals, run.parameters
    costs = {"recorded r": signals.r} if signals.has_r else {}
    if costs and model is None:
        return costs
    n = signals.measured.shape[1]
    fitting = load_fitting(model, signals.dt, n) if model is not None else None
    lifter = replace(
        parameters.lifter if parameters is not None else LifterConfig(),
        cost="raw" if fitting is None else "lifted",
        dt=signals.dt,
        measured="",
    )
    esc, held = EscConfig(), np.ones(signals.step.size, np.bool_)
    x = np.ascontiguousarray(signals.measured)
    r, _ = ReplayedLoop(esc).answer(
        lifter, esc, fitting, signals.step, x, held, np.full(x.shape[0], np.nan)
    )
    return {f"r under {fitting.model_id}" if fitting is not None else "raw r": r, **costs}
