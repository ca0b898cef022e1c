"""``koop check``: whether a rig is fit to go on, one line each."""

from __future__ import annotations

import argparse
import itertools
import math
import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_commission.fitness.arrivals import NEAR, Rhythm, rhythm
from koop_commission.fitness.reaction import (
    SERIES,
    STAGES,
    Reaction,
    order,
    percent,
    reaction,
    reaction_of_rests,
)
from koop_commission.rig.listener import (
    Ears,
    Samples,
    refuse_dead,
    refuse_wrong_names,
    speakers,
    two_rigs,
    who,
    who_else_commands,
)
from koop_commission.stages import time_scale
from koop_commission.theta.commander_client import Hand, left_at, note_of
from koop_commission.theta.limits import way_home
from koop_core.errors import LiveError
from koop_node.process.domain import current_domain
from koop_tune.excitation.channels import Channel, Line, channel, lines, listens
from koop_tune.excitation.features import Bands, bands, bridged, features
from koop_tune.excitation.staircase import away
from koop_tune.rig.rig_file import RigFile, read

LISTEN, LONGEST = 5.0, 60.0  # [s] at least and at most, before theta is moved
PERIODS = 10.0  # of the strongest oscillation, that are listened to
SETTLE, OBSERVE = 3.0, 6.0  # periods of each block of the test
LATE = 0.5  # [s] that what is heard may be behind theta on a busy machine: it settles longer
SHORTER = 0.9  # than theta usually rests in a recording, so that most rests count
QUARTER = 0.25  # of its range, by which theta is moved
SLOW = 0.02  # by which the rate may be off
LOST, LOST_BADLY = 0.001, 0.05  # shares of messages
COARSE = 0.2  # standard deviations, of a step of the values
OK, NOTE, BAD = "ok  ", "note", "BAD "


class Row(NamedTuple):
    """What was found about one thing."""

    level: str
    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.level}  {self.name:<10}  {self.text}"


def register(commands: Any) -> None:
    """Add the command to the subparsers of ``koop``."""
    parser = commands.add_parser(
        "check",
        description="Listens to a rig, then moves theta by a quarter of its range some times and "
        "tests whether anything reacts. One line each; exit code 0 only if the rig is fit to go "
        "on. theta ends at theta_safe.",
    )
    parser.add_argument("rig", metavar="RIG.YAML", help="of 'koop commission --new'")
    parser.add_argument("bag", metavar="BAG", nargs="?", help="a recording in place of the rig")
    parser.add_argument("--still", action="store_true", help="do not move theta")
    time_scale.add_to(parser)
    parser.add_argument("--seed", type=int, help="of the order in which theta is moved")
    parser.set_defaults(func=main)


def main(args: argparse.Namespace) -> int:
    """Entry point; returns the exit code: 0 only if the rig is fit to go on, 1 if it is not."""
    rig = read(args.rig)
    scale = time_scale.of(args)
    if args.bag:
        rows = of_bag(rig, Path(args.bag))
    else:
        rng = random.Random(args.seed)
        rows = live(rig, scale, not args.still, rng, note_of(args.rig))
    bad = told(rows)
    then = f"./koop excite {args.rig}" if not args.bag else "./koop train"
    print(f"\nnot fit: {bad} BAD" if bad else f"\nfit to go on: {then}")
    return 1 if bad else 0


def told(rows: Iterator[Row]) -> int:
    """Print what is found, and return how much of it is BAD."""
    bad = 0
    for row in rows:
        print(row, flush=True)
        bad += row.level == BAD
    return bad


def live(
    rig: RigFile, scale: float, moves: bool, rng: random.Random, note: Path | None = None
) -> Iterator[Row]:
    """Yield what is found about a live rig."""
    from koop_node.client.client import Client

    with Client("koop_check") as client:
        try:
            refuse_wrong_names(client, rig)
        except LiveError as error:
            yield Row(BAD, "graph", f"{error} (ROS domain {current_domain()})")
            return
        ears = Ears(client, rig.state.topic, rig.measured_type, rig.state.fields)
        listened = f"{len(who(client, rig.knob.topic)[1])} listen to {rig.knob.topic}"
        yield Row(OK, "graph", f"{rig.state.topic} is there; {listened}")
        spin = _spinner(client, ears)
        spin(lambda: False, LISTEN)
        if others := who_else_commands(client, rig.knob.topic, own=False):
            yield Row(
                BAD, "command", f"{rig.knob.topic} is commanded by {', '.join(others)}: end that"
            )
        else:
            yield Row(OK, "command", f"nobody else commands {rig.knob.topic}")
        if text := two_rigs(client, rig):
            yield Row(BAD, "arrival", text)
            return
        if not ears.count:
            yield Row(BAD, "arrival", f"no message on {rig.state.topic} in {LISTEN:g} s")
            return
        heard = ears.samples()
        end = time.monotonic() + LONGEST
        while time.monotonic() < end and listens(heard.x, rig.dt, LISTEN, PERIODS, LONGEST * scale):
            spin(lambda: False, 0.2 * LISTEN)
            heard = ears.samples()
        rows = list(passive(rig, heard, scale))
        yield from rows
        if others or not moves or any(row.level == BAD for row in rows):
            why = "--still" if not moves else "only on a rig of which nothing above is BAD"
            yield Row(NOTE, "theta", f"was not moved: {why}")
            return
        yield from _moved(rig, client, ears, spin, _period(rig, heard), scale, rng, note)


def passive(rig: RigFile, heard: Samples, scale: float = 1.0) -> Iterator[Row]:
    """Yield what samples say without a command."""
    try:
        found = rhythm(heard.arrival, heard.stamp, heard.step, rig.dt, scale)
    except ValueError as error:
        yield Row(BAD, "arrival", str(error))
        return
    yield of_arrival(rig, found, scale)
    low = rig.channel_min or (-math.inf,) * len(rig.names)
    high = rig.channel_max or (math.inf,) * len(rig.names)
    for i, name in enumerate(rig.names):
        yield of_channel(name, channel(heard.x[:, i]), low[i], high[i])
    every = [lines(x, rig.dt) for x in heard.x.T]
    for name, peaks in zip(rig.names, every, strict=True):
        if peaks:
            yield of_spectrum(name, peaks)


def of_arrival(rig: RigFile, found: Rhythm, scale: float) -> Row:
    """Judge how messages come."""
    asked = scale / rig.dt
    text = (
        f"{found.received} messages, {found.rate:.4g} a second, "
        f"jitter {1e3 * found.jitter:.2g} ms, lost {found.lost or 'none'}"
        + f" ({100.0 * found.share:.2g} %)" * bool(found.lost)
        + {"steps": ", counted by steps", "stamps": ", counted by stamps",
           "arrival": ", no stamps: counted by arrival at the known dt"}[found.source]
    )  # fmt: skip
    if not 1.0 - NEAR < found.interval / rig.dt < 1.0 + NEAR:
        slow = (
            "dt is not that, or messages are lost" if found.interval > rig.dt else "dt is not that"
        )
        return Row(
            BAD,
            "arrival",
            f"a message every {found.interval:.4g} s, dt = {rig.dt:g}: {slow}; {text}",
        )
    if found.share > LOST_BADLY:
        return Row(BAD, "arrival", f"{text}: too many")
    stalled = 2.0 * found.longest * found.rate / found.received  # one at an end shifts the count
    off = abs(found.rate / asked - 1.0)
    if not found.lost and off > SLOW + stalled:
        # steps and stamps say what dt is; a simulated rig may be slower than it was told
        level = BAD if found.source == "arrival" or off > NEAR else NOTE
        hint = " (a simulated rig: --time-scale)" * (off > NEAR)
        return Row(level, "arrival", f"{text}: dt = {rig.dt:g} s asks for {asked:.4g}{hint}")
    return Row(NOTE if found.share > LOST else OK, "arrival", text)


def of_channel(name: str, found: Channel, low: float, high: float) -> Row:
    """Judge one channel."""
    if found.bad == 1.0:
        return Row(BAD, "channel", f"{name} never is a number: dead sensor, or another field")
    if found.dead:
        return Row(BAD, "channel", f"{name} is always {found.low:g}: dead sensor")
    if found.low < low or found.high > high:
        limit = low if found.low < low else high
        text = f"{found.low:.4g} to {found.high:.4g}, beyond its limit {limit:g} before theta moves"
        return Row(BAD, "channel", f"{name} {text}")
    if found.held > 0.5:
        return Row(BAD, "channel", f"{name} is stuck for {100 * found.held:.0f} % of the time")
    text = f"{name} {found.low:.4g} to {found.high:.4g}, standard deviation {found.deviation:.3g}"
    notes = []
    if found.bad:
        notes.append(f"{100 * found.bad:.2g} % are not numbers")
    if found.held > 0.1:
        notes.append(f"stuck for {100 * found.held:.0f} % of the time")
    if found.saturated:
        notes.append(f"saturated for {100 * found.saturated:.2g} % of the time")
    coarse = found.quantum > COARSE * found.deviation
    if found.quantum:
        text += f", steps of {found.quantum:.3g}"
        notes += ["coarse: the steps are a good part of it"] * coarse
    return Row(NOTE if notes else OK, "channel", "; ".join([text, *notes]))


def of_spectrum(name: str, peaks: Sequence[Line]) -> Row:
    """Name the lines of one channel."""
    first, *others = [f"{p.frequency:.3g} Hz (amplitude {p.amplitude:.3g})" for p in peaks]
    text = f"{name} strongest at {first}"
    if others:
        text += (
            f", further lines at {', '.join(others)}: what theta does not change is interference"
        )
    return Row(OK, "spectrum", text)


def of_reaction(found: Reaction, names: Sequence[str], between: str) -> Row:
    """Judge whether theta reaches the rig; ``between`` says where it was, in words."""
    if found.p > max(alpha for _, alpha in STAGES):
        lacks = "nothing reacts"
        why = "the command is not applied, or theta has no effect there"
        return Row(BAD, "theta", f"{between}: {lacks} (p = {found.p:.2f}): {why}")
    name = names[found.feature]
    how = f"moves by {found.change:.3g}" if name.startswith("mean") else percent(found.change)
    sure = f"reaches the rig with {100 * found.confidence:.3g} % confidence"
    return Row(OK, "theta", f"{sure}; {between}: {name} {how}")


def block_features(x: NDArray[np.float64], how: Bands) -> NDArray[np.float64]:
    """Return the features of a block: the oscillation's, and the mean of each channel."""
    return np.r_[features(x, how), bridged(x).mean(axis=0)]


def block_names(how: Bands, channels: Sequence[str]) -> list[str]:
    """Return what each feature of a block is, in words."""
    return [*how.names(channels), *(f"mean {name}" for name in channels)]


def _moved(
    rig: RigFile,
    client: Any,
    ears: Ears,
    spin: Any,
    period: float,
    scale: float,
    rng: random.Random,
    note: Path | None,
) -> Iterator[Row]:
    """Move theta and yield whether anything reacted."""
    a, words = left_at(note, rig, speakers(client, rig.state.topic))
    if words:
        print(f"      {words}", flush=True)
    b = away(a, rig.theta_min, rig.theta_max, QUARTER)
    row = None
    with TemporaryDirectory() as folder, ExitStack() as stack:
        log = Path(folder) / "commander.log"
        hand = stack.enter_context(Hand(rig, log, scale=scale, note=note, theta=a))
        try:
            for longer, stages in SERIES:
                observe = max(64, math.ceil(longer * OBSERVE * period / rig.dt))
                settle = math.ceil(max(longer * SETTLE * period, LATE * scale) / rig.dt)
                each = abs(b - a) / rig.theta_rate + (settle + observe) * rig.dt
                blocks = [count for count, _ in stages]
                if row is not None and sum(blocks) * each > rig.time:
                    break  # the rig file does not allow it
                least, most = (n * each / scale for n in (blocks[0], sum(blocks)))
                print(
                    f"      moving theta between {a:.4g} and {b:.4g}: {least:.0f} s, "
                    f"at most {most:.0f} s; "
                    f"Ctrl-C ends it, theta ends at {rig.theta_safe:g}",
                    flush=True,
                )
                x = bridged(ears.samples().x)
                how = bands(x, min(observe, x.shape[0]), rig.dt)._replace(length=observe)
                names = block_names(how, rig.names)
                found: list[NDArray[np.float64]] = []
                moved: list[bool] = []
                for (count, alpha), done in zip(stages, itertools.count(1), strict=False):
                    for up in order(count, rng):
                        theta = b if up else a
                        found.append(_block(rig, hand, ears, spin, theta, settle, observe, how))
                        moved.append(up)
                    test = reaction(np.array(found), moved, blocks[:done])
                    if test.p <= alpha:
                        break
                between = f"theta from {a:.4g} to {b:.4g}, {len(moved)} blocks of {each:.3g} s"
                row = of_reaction(test, names, between)
                if row.level != BAD:
                    break
        except LiveError as error:
            row = Row(BAD, "theta", f"{error}: theta goes back to {rig.theta_safe:g}")
        if (way := way_home(rig, hand.theta) / scale) > 5.0:
            print(f"      taking theta back to {rig.theta_safe:g}: {way:.0f} s", flush=True)
    assert row is not None
    yield row
    if others := who_else_commands(client, rig.knob.topic, own=True):
        yield Row(BAD, "command", f"{rig.knob.topic} was also commanded by {', '.join(others)}")


def _block(
    rig: RigFile, hand: Hand, ears: Ears, spin: Any, theta: float, settle: int, observe: int,
    how: Bands,
) -> NDArray[np.float64]:  # fmt: skip
    """Move theta, let the rig settle, and return what is measured then."""
    hand.go(theta)
    spin(lambda: hand.there, math.inf, hand.beat)
    begin = ears.count + settle
    spin(lambda: ears.count >= begin + observe, math.inf, hand.beat)
    x = ears.samples(begin, begin + observe).x
    refuse_dead(rig.names, x)
    return block_features(x, how)


def _spinner(client: Any, ears: Ears) -> Callable[..., None]:
    def spin(
        until: Callable[[], object], seconds: float, check: Callable[[], None] = lambda: None
    ) -> None:
        deadline = time.monotonic() + seconds
        looked = 0.0
        while not until() and (now := time.monotonic()) < deadline:
            client.spin(0.05)
            if now > looked + 0.1:
                looked = now
                check()

    return spin


def _period(rig: RigFile, heard: Samples) -> float:
    """Return the period to wait by [s]: of the strongest oscillation, or half of the slowest."""
    found = [line for x in heard.x.T for line in lines(x, rig.dt)]
    if not found:
        return 64.0 * rig.dt
    strongest = max(found, key=lambda line: line.share).frequency
    return max(1.0 / strongest, 0.5 / min(line.frequency for line in found))


# -- recordings -----------------------------------------------------------------------------------


def of_bag(rig: RigFile, bag: Path) -> Iterator[Row]:
    """Yield what a recording says; theta is tested where it rested at two values or more."""
    from koop_bag.bag.columns import LOG_TIME, list_fields, read_columns
    from koop_bag.bag.reader import BagReader

    bag = bag / "bag" if (bag / "bag").is_dir() else bag
    with BagReader(bag) as reader:
        known = {topic.name: topic for topic in reader.topics if topic.count}
        if rig.state.topic not in known:
            there = ", ".join(sorted(known)) or "nothing"
            yield Row(BAD, "bag", f"holds no message of {rig.state.topic}; it has {there}")
            return
        own = set(list_fields(reader, rig.state.topic))
        wanted = [*rig.names, *(own & {"header.stamp", "step"}), LOG_TIME]
        columns = read_columns(reader, rig.state.topic, wanted)
        n = columns[LOG_TIME].size
        heard = Samples(
            columns[LOG_TIME].astype(np.float64) * 1e-9,
            columns.get("header.stamp", np.zeros(n)) * 1e-9,
            columns["step"].astype(np.int64) if "step" in columns else np.full(n, -1),
            np.column_stack([columns[name] for name in rig.names]).astype(np.float64),
        )
        theta = None
        for topic, field in ((rig.knob.topic, rig.command.rpartition(":")[2]), ("/theta", "theta")):
            if topic in known and theta is None:
                theta = read_columns(reader, topic, [field, LOG_TIME])
                times, values = theta[LOG_TIME].astype(np.float64) * 1e-9, theta[field]
    scale = _scale(heard, rig.dt)
    yield from passive(rig, heard, scale)
    if theta is None:
        yield Row(NOTE, "theta", f"is not in the bag: {rig.knob.topic}")
        return
    at = np.searchsorted(times, heard.arrival, side="right") - 1
    yield _of_rests(rig, heard, np.where(at >= 0, values[np.maximum(at, 0)], np.nan))


def _scale(heard: Samples, dt: float) -> float:
    """Return the rig's seconds in one second of a recording, by its stamps or steps."""
    span = float(heard.arrival[-1] - heard.arrival[0]) or 1.0
    if (heard.step >= 0).all() and heard.step[-1] > heard.step[0]:
        found = float(heard.step[-1] - heard.step[0]) * dt / span
    elif (heard.stamp > 0.0).all():
        found = float(heard.stamp[-1] - heard.stamp[0]) / span
    else:
        return 1.0
    return found if abs(found - 1.0) > SLOW else 1.0


def _of_rests(rig: RigFile, heard: Samples, theta: NDArray[np.float64]) -> Row:
    """Test whether the measurements differ between rests at low and at high theta."""
    ends = np.flatnonzero(np.diff(theta, append=np.inf) != 0.0)
    every = [
        (begin, end)
        for begin, end in zip(np.r_[0, ends[:-1] + 1], ends + 1, strict=True)
        if end - begin >= 64 and math.isfinite(theta[begin])
    ]
    usual = float(np.median([end - begin for begin, end in every])) if every else 0.0
    wanted = (SETTLE + OBSERVE) * _period(rig, heard) / rig.dt
    least = max(64, math.ceil(min(wanted, SHORTER * usual)))
    rests = [(begin, end) for begin, end in every if end - begin >= least]
    if len(rests) < STAGES[0][0] or np.ptp([theta[begin] for begin, _ in rests]) == 0.0:
        needed = f"{STAGES[0][0]} rests of {least * rig.dt:.3g} s at different values"
        return Row(NOTE, "theta", f"{len(rests)} rests: {needed} tell whether it reaches the rig")
    settle = math.ceil(least * SETTLE / (SETTLE + OBSERVE))
    length = least - settle
    how = bands(bridged(heard.x), length, rig.dt)
    found = np.array(
        [
            np.mean(
                [
                    block_features(heard.x[at : at + length], how)
                    for at in range(end - (end - begin - settle) // length * length, end, length)
                ],
                axis=0,
            )
            for begin, end in rests
        ]
    )
    values = np.array([theta[begin] for begin, _ in rests])
    names = block_names(how, rig.names)
    test = reaction_of_rests(found, values)
    low, high = float(values.min()), float(values.max())
    between = f"theta from {low:.4g} to {high:.4g}, {len(rests)} rests"
    row = of_reaction(test, names, between)
    if row.level == BAD:  # nobody chose the rests for this test: it may have missed an effect
        return Row(NOTE, "theta", f"{between}: no effect is seen (p = {test.p:.2f})")
    return row
