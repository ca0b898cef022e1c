"""``koop check``: whether a rig is fit to be commissioned, a line for each finding."""

from __future__ import annotations

import argparse
import itertools
import math
import random
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_commission.fitness.fitness import (
    BAD,
    NOTE,
    OK,
    Finding,
    choose_period,
    compute_block_features,
    judge_reaction,
    judge_samples,
    name_block_features,
)
from koop_commission.fitness.reaction import SERIES, compare_blocks, draw_order
from koop_commission.fitness.recording import check_recording
from koop_commission.fitness.samples import Samples, refuse_dead
from koop_commission.fitness.settings import DEFAULTS, CheckSettings
from koop_commission.rig.graph import (
    describe_second_rig,
    find_other_publishers,
    identify_publishers,
    refuse_missing_topics,
)
from koop_commission.rig.listener import Listener
from koop_commission.theta.assignment import Assignment
from koop_commission.theta.commander_client import CommanderClient, find_theta, note_of
from koop_commission.theta.limits import compute_return_time
from koop_core.errors import LiveError
from koop_node.client.client import Client
from koop_node.process.domain import current_domain
from koop_tune.excitation.channels import should_listen
from koop_tune.excitation.features import Bands, bridge_gaps, choose_bands
from koop_tune.rig.rig_file import RigFile, read

SLOW_RETURN = 5.0  # [s] from which on the return of theta is announced


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "check",
        description="Listens to a rig, then moves theta by a quarter of its range several times "
        "and tests whether the rig reacts. One line for each finding; exit code 0 only if the rig "
        "is fit to be commissioned. theta returns to theta_safe.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="rig file, from 'koop commission --new'")
    parser.add_argument("bag", metavar="BAG", nargs="?", help="a recording in place of the rig")
    parser.add_argument("--still", action="store_true", help="do not move theta")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is fit, 1 if it is not."""
    rig = read(args.rig)
    if args.bag:
        bad = print_findings(check_recording(rig, Path(args.bag)))
    else:
        bad = print_findings(check_rig(rig, moves=not args.still, note=note_of(args.rig)))
    command = f"./koop excite {args.rig}" if not args.bag else "./koop train"
    print(f"\nnot fit: {bad} BAD" if bad else f"\nfit; next: {command}")
    return 1 if bad else 0


def print_findings(findings: Iterable[Finding]) -> int:
    """Print findings as they come, and return how many are BAD."""
    bad = 0
    for finding in findings:
        print(finding, flush=True)
        bad += finding.level == BAD
    return bad


def check_rig(
    rig: RigFile,
    moves: bool = True,
    note: Path | None = None,
    rng: random.Random | None = None,
    settings: CheckSettings = DEFAULTS,
) -> Iterator[Finding]:
    """Yield the findings of a live rig.

    Parameters
    ----------
    rig : RigFile
        The rig.
    moves : bool
        Whether theta is moved.
    note : Path, optional
        File that notes where theta was left.
    rng : random.Random, optional
        Draws the order in which theta is moved.
    settings : CheckSettings
        Times and thresholds.
    """
    with Client("koop_check") as client:
        try:
            refuse_missing_topics(client, rig)
        except LiveError as error:
            yield Finding(BAD, "graph", f"{error} (ROS domain {current_domain()})")
            return
        listener = Listener(client, rig.state.topic, rig.measured_type, rig.state.fields)
        topic = rig.knob.topic
        text = f"{rig.state.topic} has a publisher, {topic} has a subscriber"
        yield Finding(OK, "graph", text)
        live = LiveCheck(rig, client, listener, note, rng or random.Random(), settings)
        live.spin(settings.listen)
        if others := find_other_publishers(client, topic, commanding=False):
            text = f"{topic} is commanded by {', '.join(others)}: stop that"
            yield Finding(BAD, "command", text)
        else:
            yield Finding(OK, "command", f"{topic} has no other publisher")
        if text := describe_second_rig(client, rig):
            yield Finding(BAD, "arrival", text)
            return
        if not listener.count:
            text = f"no message on {rig.state.topic} in {settings.listen:g} s"
            yield Finding(BAD, "arrival", text)
            return
        samples = live.listen()
        findings = list(judge_samples(rig, samples, rig.pace, settings))
        yield from findings
        if not moves:
            yield Finding(NOTE, "theta", "was not moved: --still")
        elif others or any(finding.level == BAD for finding in findings):
            yield Finding(NOTE, "theta", "was not moved: something above is BAD")
        else:
            yield from live.move_theta(choose_period(rig, samples))


@dataclass(frozen=True)
class Blocks:
    """Blocks of one series of the test: two values of theta, samples to leave out and to take."""

    low: float
    high: float
    settle: int
    observe: int
    bands: Bands


@dataclass
class LiveCheck:
    """A rig that is listened to and whose theta is moved; the attributes are those of the check."""

    rig: RigFile
    client: Client
    listener: Listener
    note: Path | None
    rng: random.Random
    settings: CheckSettings

    def spin(
        self,
        seconds: float = math.inf,
        until: Callable[[], object] = lambda: False,
        check: Callable[[], object] = lambda: None,
    ) -> None:
        """Receive messages for a time [s], or until a condition; ``check`` is called meanwhile."""
        deadline, checked = time.monotonic() + seconds, 0.0
        while not until() and (now := time.monotonic()) < deadline:
            self.client.spin(0.05)
            if now > checked + 0.1:
                checked = now
                check()

    def listen(self) -> Samples:
        """Listen for some periods of the strongest oscillation; return all samples so far."""
        own, rig = self.settings, self.rig
        end = time.monotonic() + own.longest
        samples = self.listener.samples()
        while time.monotonic() < end and should_listen(
            samples.x, rig.dt, own.listen, own.periods, own.longest * rig.pace
        ):
            self.spin(0.2 * own.listen)
            samples = self.listener.samples()
        return samples

    def move_theta(self, period: float) -> Iterator[Finding]:
        """Move theta and yield whether anything reacted; ``period`` of the oscillation [s]."""
        rig, topic = self.rig, self.rig.knob.topic
        publishers = identify_publishers(self.client, rig.state.topic)
        theta, remark = find_theta(self.note, rig, publishers)
        if remark:
            print(f"      {remark}", flush=True)
        note = str(self.note.resolve()) if self.note is not None else ""
        with TemporaryDirectory() as folder, ExitStack() as stack:
            commander = stack.enter_context(
                CommanderClient(Assignment(rig, theta, note=note), Path(folder) / "commander.log")
            )
            try:
                finding = self._run_series(commander, theta, period)
            except LiveError as error:
                text = f"{error}: theta returns to theta_safe = {rig.theta_safe:g}"
                finding = Finding(BAD, "theta", text)
            if (seconds := compute_return_time(rig, commander.theta)) > SLOW_RETURN:
                where = f"theta_safe = {rig.theta_safe:g}"
                print(f"      theta returns to {where}: {seconds:.0f} s", flush=True)
        yield finding
        if others := find_other_publishers(self.client, topic, commanding=True):
            yield Finding(BAD, "command", f"{topic} was also commanded by {', '.join(others)}")

    def _run_series(self, commander: CommanderClient, theta: float, period: float) -> Finding:
        """Test with blocks of growing length until the rig reacts or the time is over."""
        rig, own = self.rig, self.settings
        other = rig.scale.step_away(theta, own.step)
        finding = None
        for factor, stages in SERIES:
            observe = max(64, math.ceil(factor * own.observe * period / rig.dt))
            settle = math.ceil(max(factor * own.settle * period, own.late * rig.pace) / rig.dt)
            seconds = abs(other - theta) / rig.theta_rate + (settle + observe) * rig.dt
            counts = [count for count, _ in stages]
            if finding is not None and sum(counts) * seconds > rig.time:
                break  # the rig file does not allow it
            least, most = (n * seconds / rig.pace for n in (counts[0], sum(counts)))
            print(
                f"      moving theta between {theta:.4g} and {other:.4g}: {least:.0f} s, at most "
                f"{most:.0f} s; Ctrl-C ends it, theta returns to {rig.theta_safe:g}",
                flush=True,
            )
            x = bridge_gaps(self.listener.samples().x)
            bands = choose_bands(x, min(observe, x.shape[0]), rig.dt)._replace(length=observe)
            blocks = Blocks(theta, other, settle, observe, bands)
            features: list[NDArray[np.float64]] = []
            moved: list[bool] = []
            for (count, alpha), done in zip(stages, itertools.count(1), strict=False):
                for up in draw_order(count, self.rng):
                    features.append(self._run_block(commander, blocks, up))
                    moved.append(up)
                reaction = compare_blocks(np.array(features), moved, counts[:done])
                if reaction.p <= alpha:
                    break
            between = (
                f"theta from {theta:.4g} to {other:.4g}, {len(moved)} blocks of {seconds:.3g} s"
            )
            finding = judge_reaction(reaction, name_block_features(bands, rig.names), between)
            if finding.level != BAD:
                break
        assert finding is not None
        return finding

    def _run_block(
        self, commander: CommanderClient, blocks: Blocks, up: bool
    ) -> NDArray[np.float64]:
        """Move theta, let the rig settle, and return the features of the block that follows."""
        commander.go(blocks.high if up else blocks.low)
        self.spin(until=lambda: commander.arrived, check=commander.check)
        begin = self.listener.count + blocks.settle
        end = begin + blocks.observe
        self.spin(until=lambda: self.listener.count >= end, check=commander.check)
        x = self.listener.samples(begin, end).x
        refuse_dead(self.rig.names, x)
        return compute_block_features(x, blocks.bands)
