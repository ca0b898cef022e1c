"""``koop replay``: a recording through the controller again."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.text_table import table
from koop_identify.recording.passes import each_knob
from koop_lab.cli.source_options import add_namespace_option
from koop_lab.replay.answers import replay
from koop_lab.replay.plan import ReplayPlan, make_plan
from koop_lab.replay.recording import Recording, read_recording

NOT_IN_THE_BAG = (
    "not in a bag, so not replayed: a restart, a reset or an inactive phase of a node, and what "
    "the filters held before the recording began"
)


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "replay",
        description="Feeds the recorded states through lifter and controller and compares "
        "cost and theta with the recorded ones, bit by bit. Exit code 1 if they differ. With "
        "another model or other parameters it shows what the controller would have answered to "
        "the same states; the plant does not react to it.",
    )
    parser.add_argument("bag", type=Path, help="folder of a run or of a bag, or an .mcap file")
    parser.add_argument("--model", metavar="FILE", help="another Koopman model")
    parser.add_argument(
        "--params-file", metavar="FILE", help="ROS 2 parameter file of other parameters"
    )
    add_namespace_option(parser)
    parser.add_argument(
        "--out", type=Path, metavar="FILE",
        help="write the answers as .npz",
    )  # fmt: skip
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 1 if an answer differs."""
    recording = read_recording(args.bag, args.namespace)
    plan = make_plan(recording, args.params_file, args.model)
    started = time.perf_counter()
    r, theta = replay(recording, plan)
    elapsed = time.perf_counter() - started
    results = [
        compare(name, recording.step[present], recorded[present], now[present])
        for signal, before, after, present in (
            ("r", recording.r, r, recording.has_r),
            ("theta", recording.theta, theta, recording.has_theta),
        )
        for (name, recorded), now in zip(
            each_knob(signal, before).items(), each_knob(signal, after).values(), strict=True
        )
    ]
    differs = any(different for different, _ in results)
    print(f"{args.bag}: {recording.step.size} states in {elapsed:.2f} s")
    print("\n".join([*describe(recording, plan), *(text for _, text in results)]))
    if differs and not plan.differences:
        complete = not recording.without_parameters
        print("parameters and model are the recorded ones\n" * complete + NOT_IN_THE_BAG)
    if args.out is not None:
        with open(args.out, "wb") as file:
            np.savez(
                file, step=recording.step, r=r, theta=theta, recorded_r=recording.r,
                recorded_theta=recording.theta,
            )  # fmt: skip
    return 1 if differs else 0


def describe(recording: Recording, plan: ReplayPlan) -> list[str]:
    """Return with what a recording was replayed, in lines for the terminal."""
    lines = list(plan.notes)
    if recording.repeated:
        lines.append(f"{recording.repeated} states that were sent again are left out")
    if recording.unanswered:
        lines.append(f"{recording.unanswered} states without a recorded cost are left out")
    last = max(np.flatnonzero(recording.has_theta), default=0)
    if count := np.count_nonzero((recording.has_r & ~recording.has_theta)[:last]):
        lines.append(
            f"{count} costs without a recorded theta are replayed as if the controller had been "
            "active"
        )
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
    return lines


def compare(
    name: str,
    step: NDArray[np.int64],
    recorded: NDArray[np.float64],
    replayed: NDArray[np.float64],
) -> tuple[int, str]:
    """Compare a signal, of shape (M,), bit by bit; two values that are not a number are equal.

    Returns
    -------
    different : int
        How many values differ.
    text : str
        The same in words, with the first difference and the largest.
    """
    if not step.size:
        return 0, f"{name:<6} nothing recorded to compare with"
    same = recorded.view(np.int64) == replayed.view(np.int64)  # 0.0 and -0.0 differ
    rows = np.flatnonzero(~(same | (np.isnan(recorded) & np.isnan(replayed))))
    if not rows.size:
        return 0, f"{name:<6} identical bit for bit in all {step.size} steps"
    with np.errstate(invalid="ignore"):  # infinite where only one of them is a number
        distance = np.nan_to_num(np.abs(recorded - replayed)[rows], nan=np.inf, posinf=np.inf)
    k, largest = rows[0], int(np.argmax(distance))
    return rows.size, (
        f"{name:<6} differs in {rows.size} of {step.size} steps, first at step {step[k]}: "
        f"recorded {float(recorded[k])!r}, replayed {float(replayed[k])!r}; largest difference "
        f"{distance[largest]:.6g} at step {step[rows[largest]]}"
    )
