"""``koop replay``: a recording through the controller again."""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from koop_core.errors import InputError
from koop_core.text_table import table
from koop_identify.recording.segmentation import BagReading
from koop_identify.recording.signals import read_signals
from koop_lab.cli.source_options import add_reading_options, reading_of
from koop_lab.replay.compare import Comparison, compare
from koop_lab.replay.offline import replay_offline
from koop_lab.replay.plan import ReplayPlan, make_plan
from koop_lab.replay.recording import Recording, read_recording
from koop_lab.replay.unheard import first_theta
from koopman_lifter.model import load

SHOWN = 10  # places where a node was restarted


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "replay",
        description="Feeds the recorded states through the real lifter and controller and compares "
        "cost and theta with the recorded ones, bit by bit. Exit code 1 if they differ. With "
        "another model or other parameters it shows what the controller would have answered to "
        "the same states; the plant does not react to it. With --measured and --offline: r and "
        "theta that lifter and controller would give to the states of any bag, open loop; the cost "
        "is raw without a --model.",
    )
    parser.add_argument("bag", type=Path, help="folder of a run or of a bag, or an .mcap file")
    parser.add_argument(
        "--offline", action="store_true", help="on the kernels, without DDS: much faster"
    )
    parser.add_argument("--model", metavar="FILE", help="another Koopman model")
    parser.add_argument(
        "--params-file", metavar="FILE", help="ROS 2 parameter file of other parameters"
    )
    parser.add_argument("--namespace", default="/", help="namespace of the recorded loop")
    parser.add_argument(
        "--out", type=Path, metavar="FILE",
        help="write the answers as .npz",
    )  # fmt: skip
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="with --measured: draw the answers (png, svg, pdf)",
    )
    add_reading_options(parser.add_argument_group("a bag of other messages than the loop's"))
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if an answer differs."""
    reading = reading_of(args)
    if reading is not None:
        return open_loop_main(args, reading)
    if args.plot is not None:
        raise InputError("--plot needs --measured; koop bag plot draws a run")
    recording = read_recording(args.bag, args.namespace)
    plan = make_plan(recording, args.params_file, args.model)
    started = time.perf_counter()
    if args.offline:
        r, theta = replay_offline(recording, plan)
    else:
        from koop_lab.replay.feed import replay_live  # needs ROS

        r, theta = replay_live(recording, plan)
    elapsed = time.perf_counter() - started
    results = [
        compare("r", recording.step, recording.r, r, recording.has_r),
        compare("theta", recording.step, recording.theta, theta, recording.has_theta),
    ]
    way = "offline" if args.offline else "through the nodes over DDS"
    print(f"{args.bag}: {recording.step.size} states {way} in {elapsed:.2f} s")
    print("\n".join(report(recording, plan, results)))
    if args.out is not None:
        with open(args.out, "wb") as file:
            np.savez(
                file, step=recording.step, r=r, theta=theta, recorded_r=recording.r,
                recorded_theta=recording.theta,
            )  # fmt: skip
    return 1 if any(result.different for result in results) else 0


def open_loop_main(args: argparse.Namespace, reading: BagReading) -> int:
    """Answer the states of any bag; returns the exit code."""
    from koop_lab.replay import open_loop

    if not args.offline:
        raise InputError(
            "--measured needs --offline: through the nodes only states of a loop are fed"
        )
    model = load(Path(args.model)) if args.model else None
    if model is not None and reading.dt is not None and reading.dt != model.dt:
        raise InputError(f"--dt {reading.dt:g}: the model was learned at {model.dt:g} s")
    signals = read_signals(args.bag, reading, model.dt if model is not None else None)
    made = open_loop.settings(signals.dt, args.model, args.params_file)
    answers = open_loop.answer(signals, made, str(reading.measured))
    print(f"{args.bag}: {signals.step.size} states of {reading.measured} ({signals.way})")
    print("\n".join(open_loop.describe(signals, made, answers)))
    if args.out is not None:
        open_loop.write(args.out, signals, answers)
        print(f"written to {args.out}")
    if args.plot is not None:
        from koop_lab.plots.signals import plot_signals  # matplotlib is slow to import

        thetas = {"would have said (open loop)": answers.theta}
        if signals.has_theta:
            thetas["recorded"] = signals.theta
        plot_signals(
            args.plot,
            signals.t,
            dict(zip(signals.names, signals.x.T, strict=True)),
            {"r under the model": answers.r},
            thetas,
            f"{args.bag}: {reading.measured}, open loop",
        )
        print(f"drawn to {args.plot}")
    return 0


def report(recording: Recording, plan: ReplayPlan, results: list[Comparison]) -> list[str]:
    """Return what a replay found, in lines for the terminal."""
    lines = list(plan.notes)
    if recording.repeated:
        lines.append(f"{recording.repeated} states that were sent again are left out")
    if recording.unanswered:
        lines.append(f"{recording.unanswered} states without a recorded cost are left out")
    if unheard := int(np.count_nonzero(plan.unheard)):
        lines.append(f"{unheard} costs without a recorded theta are kept from the controller")
    lines += [
        f"from step {recording.step[change.index]} on, as recorded: {change.node} "
        + ", ".join(f"{name} = {value}" for name, value in change.values.items())
        for segment in plan.segments
        for change in segment.changed
    ]
    if plan.differences:
        rows = [[name, str(before), str(now)] for name, before, now in plan.differences]
        lines += ["what the controller would have answered with other parameters:", ""]
        lines += [table(["parameter", "recorded", "replayed"], rows), ""]
    lines += [str(result) for result in results]
    if not any(result.different for result in results) or plan.differences:
        return lines
    if not recording.without_parameters:
        lines.append("parameters and model are the recorded ones")
    if recording.in_progress:
        lines.append(
            f"the recording begins in mid-run (the first cost is {recording.r[0]:.6g}, not 0): "
            "what the filters held before it is not in the bag"
        )
    return lines + describe_late_start(recording, plan) + describe_restarts(recording, plan)


def describe_late_start(recording: Recording, plan: ReplayPlan) -> list[str]:
    """Return a line if theta begins late, which may be why it differs."""
    first = first_theta(recording.has_r, recording.has_theta)
    if first is None or plan.unheard[:first].any():
        return []
    begin = recording.step[np.flatnonzero(recording.has_r)[0]]
    return [
        f"the controller joined at step {recording.step[first]}, or its thetas were recorded only "
        f"from there on: costs begin at step {begin}, and what it held before is not in the bag"
    ]


def describe_restarts(recording: Recording, plan: ReplayPlan) -> list[str]:
    """Return where recorded answers show a restart of a node, which a replay does not repeat.

    A lifter that is started in mid-run says that it has to settle. Theta moves by a relay step at
    the most, unless it is set back.
    """
    changed = {change.index for segment in plan.segments for change in segment.changed}
    lines = []
    rows = np.flatnonzero(recording.has_r)
    for before, k in pairwise(rows):
        on = recording.step[k] > recording.step[before] and k not in changed
        if on and recording.settling[k] and not recording.settling[before]:
            lines.append(
                f"the lifter was restarted before step {recording.step[k]}: the recorded cost has "
                "to settle there, which is not replayed"
            )
    largest = max(segment.parameters.esc.step_size for segment in plan.segments)
    rows = np.flatnonzero(recording.has_theta)
    logarithmic = plan.segments[0].parameters.esc.theta_scale == "log"
    u = np.log(recording.theta[rows]) if logarithmic else recording.theta[rows]
    jumps = np.abs(np.diff(u)) > largest * (1.0 + 1e-6)  # beyond any rounding
    for i in np.flatnonzero(jumps & ~np.append(False, jumps[:-1])):  # a ramp is one jump
        before, k = rows[i], rows[i + 1]
        if k not in changed:
            lines.append(
                f"the recorded theta jumps from {recording.theta[before]:.6g} to "
                f"{recording.theta[k]:.6g} at step {recording.step[k]}: the controller was reset "
                "or restarted there, which is not replayed"
            )
    return lines[:SHOWN]
