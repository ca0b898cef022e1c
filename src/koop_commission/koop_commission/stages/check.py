"""``koop check``: whether a rig is fit to be commissioned, a line for each finding."""

from __future__ import annotations

import argparse
import itertools
import math
import random
import select
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from koop_bringup.live.loop import LiveNodes
from koop_bringup.plan import Plan
from koop_commission.fitness.fitness import (
    BAD,
    NOTE,
    OK,
    Blocks,
    Finding,
    choose_period,
    judge_reaction,
    judge_samples,
)
from koop_commission.fitness.reaction import compare_blocks, draw_order
from koop_commission.fitness.recording import check_recording
from koop_commission.fitness.samples import Samples, refuse_dead
from koop_commission.fitness.settings import DEFAULTS, CheckSettings
from koop_commission.fitness.time_out import NAME as TIME_OUT
from koop_commission.fitness.time_out import (
    describe_doubt,
    is_back,
    judge_time_out,
    tell_apart,
)
from koop_commission.rig.graph import (
    describe_other_commanders,
    describe_rest,
    describe_second_rig,
    find_types,
)
from koop_commission.rig.guarded_theta import GUARD, guard_section
from koop_commission.rig.listener import Listener
from koop_commission.stages.safe_range import find_safe_range
from koop_commission.stages.session import Session, spell_time
from koop_core.config.knobs import format_knobs
from koop_core.errors import LiveError
from koop_guard.note import note_of
from koop_node.client.client import Client
from koop_node.process.domain import current_domain
from koop_tune.excitation.amplitude import Windows, bridge_gaps
from koop_tune.excitation.channels import should_listen
from koop_tune.rig.rig_file import RigFile, read


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "check",
        description="Listens to a rig, then moves theta by a quarter of its range several times "
        "and tests whether the rig reacts; first how far a constraint lets theta go, step by step, "
        "where it bounds a signal. One line for each finding; exit code 0 only if the rig is fit "
        "to be commissioned. theta returns to theta_safe. If you say yes, it also tests whether "
        "the rig returns theta by itself where nobody commands.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="rig file, from 'koop commission --new'")
    parser.add_argument("bag", metavar="BAG", nargs="?", help="a recording in place of the rig")
    parser.add_argument("--still", action="store_true", help="do not move theta")
    parser.set_defaults(func=main)


def ask_yes(question: str, wait_until: Callable[[Callable[[], object]], object]) -> bool:
    """Return whether the user says yes; nobody is asked without a terminal.

    ``wait_until(condition)`` looks after the rig until there is an answer.
    """
    if not sys.stdin.isatty():
        return False
    print(f"{question} [y/N] ", end="", flush=True)
    wait_until(lambda: select.select([sys.stdin], [], [], 0.0)[0])
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is fit, 1 if it is not."""
    rig = read(args.rig)
    if args.bag:
        bad = print_findings(check_recording(rig, Path(args.bag)))
    else:
        bad = print_findings(check_rig(rig, not args.still, note_of(args.rig), ask=ask_yes))
    command = f"./koop excite {args.rig}" if not args.bag else "./koop train"
    print(f"\nnot fit: {bad} BAD" if bad else f"\nfit; next: {command}")
    return 1 if bad else 0


def print_findings(findings: Iterable[Finding]) -> int:
    """Print findings as they come, and return how many are BAD."""
    bad = 0
    for finding in findings:
        tqdm.write(str(finding))
        bad += finding.level == BAD
    return bad


def check_rig(
    rig: RigFile,
    moves: bool = True,
    note: Path | None = None,
    rng: random.Random | None = None,
    settings: CheckSettings = DEFAULTS,
    ask: Callable[[str, Any], bool] = lambda question, wait_until: False,
) -> Iterator[Finding]:
    """Yield the findings of a live rig.

    ``note`` is the file that notes where theta was left, ``rng`` draws the order in which theta is
    moved, ``settings`` say how long the rig is listened to and may be silent; ``ask`` is as
    :func:`ask_yes`.
    """
    state, command = rig.measured_source.topic, rig.command_topics
    with Client("_koop_check") as client:
        try:
            state_type, command_types = find_types(client, rig)
        except LiveError as error:
            yield Finding(BAD, "graph", f"{error} (ROS domain {current_domain()})")
            return
        yield Finding(OK, "graph", f"{state} has a publisher, {command} a subscriber")
        listener = Listener(client, state, state_type, rig.measured_source.fields)
        samples = _listen(listener, rig, settings)
        if text := describe_second_rig(client, rig):
            yield Finding(BAD, "arrival", text)
            return
        findings = [Finding(OK, "command", f"no other publisher on {command}")]
        if text := describe_rest(rig, command_types):
            findings = [Finding(NOTE, "command", text)]
        if text := describe_other_commanders(client, rig):
            findings = [Finding(BAD, "command", text)]
        findings += judge_samples(rig, samples, rig.pace)
        yield from findings
        if not moves or any(finding.level == BAD for finding in findings):
            reason = "something above is BAD" if moves else "--still"
            yield Finding(NOTE, "theta", f"was not moved: {reason}")
            return
        period = choose_period(rig, samples)
        try:
            with TemporaryDirectory() as folder:
                sections = {GUARD: guard_section(rig, note)}
                if rig.bounded is not None:  # its margin comes with the cost
                    lifter = {"cost": "raw", "listeners": GUARD, **rig.lifter_input}
                    sections["koopman_lifter"] = lifter
                with LiveNodes(Path(folder), Plan(sections, rig=True)) as nodes:
                    session = Session(rig, client, listener, command_types, nodes, note)
                    with session.command_theta():
                        if rig.bounded is not None:
                            rig = find_safe_range(rig, rig.bounded, session).narrow(rig)
                        draw = rng or random.Random()
                        moved, block = _move_theta(rig, session, period, draw)
                        yield from moved
                        fit = all(finding.level != BAD for finding in moved)
                        session.hide()  # not over the question
                        if fit and ask(describe_test(rig, block, settings), session.wait_until):
                            yield _test_time_out(rig, session, block, settings)
                        elif fit:
                            yield Finding(
                                NOTE,
                                TIME_OUT,
                                "of the rig was not tested; koop check, in a terminal, offers to",
                            )
        except LiveError as error:
            yield Finding(BAD, "theta", str(error))


def _listen(listener: Listener, rig: RigFile, settings: CheckSettings) -> Samples:
    """Listen for some periods of the strongest oscillation."""
    end = time.monotonic() + settings.longest
    listener.wait(settings.listen)
    while (samples := listener.samples()).x.size and time.monotonic() < end:
        if not should_listen(
            samples.x, rig.dt, settings.listen, settings.periods, settings.longest * rig.pace
        ):
            break
        listener.wait(0.2 * settings.listen)
    return samples


class _Block(NamedTuple):
    """How theta is moved and a block is looked at."""

    share: float
    """Of its range by which theta moves."""
    settle: int
    """States that are left out first."""
    blocks: Blocks
    """How those after them are compared."""


def _move_theta(
    rig: RigFile, session: Session, period: float, rng: random.Random
) -> tuple[list[Finding], _Block]:
    """Test each knob, in longer blocks and farther until the rig reacts or the time is over.

    On the floor of a wide valley a small step changes nothing. Returned is also how the last blocks
    were. Of several knobs one is enough: another that does nothing is noted.
    """
    theta, findings = session.theta.value, list[Finding]()
    for number, (factor, stages) in enumerate(DEFAULTS.series, 1):
        observe = max(64, math.ceil(factor * DEFAULTS.observe * period / rig.dt))
        settle = math.ceil(
            max(factor * DEFAULTS.settle * period, DEFAULTS.late * rig.pace) / rig.dt
        )
        whole = sum(count for count, _ in stages) * (settle + observe) * rig.dt
        if findings and rig.count * whole > rig.time:
            break  # the rig file does not allow it
        again = "nothing reacts yet, so in longer blocks and farther: " * bool(findings)
        x = bridge_gaps(session.listener.samples().x)
        blocks = Blocks.choose(x, Windows(observe, rig.dt))
        block = _Block(number * DEFAULTS.step, settle, blocks)
        findings = [
            _move_knob(rig, session, theta, knob, again, block, stages, rng)
            for knob in range(rig.count)
        ]
        if any(finding.level != BAD for finding in findings):
            findings = [f._replace(level=NOTE) if f.level == BAD else f for f in findings]
            break
    return findings, block


def _move_knob(
    rig: RigFile, session: Session, theta: tuple[float, ...], knob: int, again: str, block: _Block,
    stages: Sequence[tuple[int, float]], rng: random.Random,
) -> Finding:  # fmt: skip
    """Test whether the rig reacts to one knob."""
    share, settle, blocks = block
    other = step_away(rig, theta, share, knob)
    way = abs(other[knob] - theta[knob]) / rig.each("theta_rate")[knob]
    seconds = way + (settle + blocks.windows.length) * rig.dt
    counts, name = [count for count, _ in stages], rig.knob_names[knob]
    most = spell_time(sum(counts) * seconds, rig.pace)
    tqdm.write(
        f"      {again}moving {name} between {theta[knob]:.4g} and {other[knob]:.4g}, at most "
        f"{most}; Ctrl-C ends it, theta returns to {rig.spell('theta_safe')}",
    )
    features: list[NDArray[np.float64]] = []
    moved: list[bool] = []
    for (count, alpha), done in zip(stages, itertools.count(1), strict=False):
        for up in draw_order(count, rng):
            features.append(_observe(rig, session, other if up else theta, settle, blocks))
            moved.append(up)
        reaction = compare_blocks(np.array(features), moved, counts[:done])
        if reaction.p <= alpha:
            break
    between = (
        f"{name} from {theta[knob]:.4g} to {other[knob]:.4g}, {len(moved)} blocks of "
        f"{seconds:.3g} s"
    )
    finding = judge_reaction(reaction, blocks.names(rig.names), between)
    return finding._replace(name=name)


def step_away(
    rig: RigFile, theta: Sequence[float], share: float, knob: int | None = None
) -> tuple[float, ...]:
    """Return theta with a knob, or all of them, a share of the range away that it has there."""
    return rig.limit([
        rig.section(k, theta).scale.step_away(value, share) if knob in (None, k) else value
        for k, value in enumerate(theta)
    ])  # fmt: skip


def describe_test(rig: RigFile, block: _Block, settings: CheckSettings) -> str:
    """Return the question whether to test for a time-out of the rig."""
    far = format_knobs(step_away(rig, rig.each("theta_safe"), block.share), ".4g")
    return (
        f"      Has the rig a time-out of its own? To see, theta stays at {far} for up to "
        f"{settings.silence:g} s without a guard, and nothing is commanded. Test that?"
    )


def _test_time_out(
    rig: RigFile, session: Session, block: _Block, settings: CheckSettings
) -> Finding:
    """Stop guard and twin beside theta_safe, and see whether the rig returns by itself.

    What the guard then does is no longer looked at: it may trip for what it did not hear.
    """
    safe, (share, settle, blocks) = rig.each("theta_safe"), block
    far = step_away(rig, safe, share)
    known: dict[tuple[float, ...], list[NDArray[np.float64]]] = {safe: [], far: []}
    for theta in tuple(known) * DEFAULTS.known:
        known[theta].append(_observe(rig, session, theta, settle, blocks))
    telling = tell_apart(np.array(known[far]), np.array(known[safe]))
    if doubt := describe_doubt(telling):
        return Finding(NOTE, TIME_OUT, doubt)
    length, listener = blocks.windows.length, session.listener
    shares: list[float] = []
    ends: list[float] = []
    with session.silenced(settings.silence):
        begun = time.monotonic()
        while not is_back(shares):
            first, left = listener.count, begun + settings.silence - time.monotonic()
            if not session.client.spin_until(lambda: listener.count >= first + length, left):  # noqa: B023
                break
            x = listener.samples(first, first + length).x
            shares.append(telling.share(blocks.features(x)))
            ends.append(time.monotonic() - begun)
    return judge_time_out(rig, far, shares, ends)


def _observe(
    rig: RigFile, session: Session, theta: Sequence[float], settle: int, blocks: Blocks
) -> NDArray[np.float64]:
    """Move theta, let the rig settle, and return the features of the block that follows."""
    session.go(theta)
    session.wait_for_states(settle, "settling")
    begin = session.listener.count
    session.wait_for_states(blocks.windows.length, "observing")
    x = session.listener.samples(begin, begin + blocks.windows.length).x
    refuse_dead(rig.names, x)
    return blocks.features(x)
