"""The test stand of a simulated rig: its clock, its actuator, and its exchange of messages."""

from __future__ import annotations

import argparse
import importlib
import math
import os
import random
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

SHORTEST = 0.02  # [s] between two looks for listeners
DRIFT = 200e-6  # of the rig's clock [s/s]
OLDEST = 0.5  # age of the state behind a command, beyond which it is ignored [s of real time]


INSTALL = "pip install --no-deps -r requirements/plants.txt"


def plant_of_others(package: str) -> Any:
    """Import a package that comes with a plant; ValueError says how to install it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ValueError(f"{error}: {INSTALL}") from None


class Actuation(NamedTuple):
    """The actuator of a knob."""

    start: float
    low: float
    high: float
    """Theta at first, and its stroke."""
    delay: float = 0.0
    rate: float = 0.0
    """A command acts so late [s]; largest change a second, 0: none."""


class SimulatedRig(Protocol):
    """A rig, as its module makes it of the command line; the stand does the rest."""

    dt: float
    """Time between two samples [s]."""
    actuations: Sequence[Actuation]
    """What moves theta, one for each knob."""
    message: str
    """Type of the measurements, a key of ``wire.MESSAGES``."""
    topics: tuple[str, ...]
    """Topics of the measurements and of each knob, unless the command line names others."""
    advance: Callable[..., None]
    """``advance(t, *theta)`` goes on by one sample; ValueError is raised if the rig breaks."""

    def measure(self, t: float, rng: random.Random) -> tuple[Sequence[float], Sequence[float]]:
        """Return what the sensors say at a time [s], and the true state."""

    def set(self, name: str, value: float) -> None:
        """Set what ``--at`` names; by default there is nothing."""
        raise ValueError(f"--at: this rig has no {name!r}")


class Actuator:
    """Follows the command late, no faster than it can, within its stroke."""

    def __init__(self, actuation: Actuation, dt: float) -> None:
        self.theta, self.step = actuation.start, -1
        self._actuation = actuation
        self._commands = deque([(actuation.start, -1)] * (round(actuation.delay / dt) + 1))
        self._most = actuation.rate * dt if actuation.rate > 0.0 else math.inf

    def move(self, command: float, step: int) -> float:
        """Return theta for the next step, given a command and the step that it answers."""
        self._commands.append((min(max(command, self._actuation.low), self._actuation.high), step))
        wanted, self.step = self._commands.popleft()
        change = wanted - self.theta
        self.theta += min(max(change, -self._most), self._most)
        return self.theta


def run(rig: SimulatedRig, args: argparse.Namespace) -> None:
    """Run a rig at its own pace, with its own clock, until its time is over or it is stopped.

    Raises ValueError if the rig breaks.
    """
    from rig_log import Log
    from wire import Wire  # Cyclone DDS: a wrong argument is reported without it

    state, theta, *others = rig.topics
    wire = Wire(args.state or state, [args.theta or theta, *others], rig.message, args.truth)
    stop: list[object] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    if args.until_eof:  # a read returns when the parent has ended: nothing is ever written
        threading.Thread(target=lambda: stop.append(os.read(0, 1)), daemon=True).start()
    while wire.readers < args.readers and not stop:
        time.sleep(SHORTEST)
    print("connected", flush=True)
    begin, wall = time.monotonic(), time.time()
    period = rig.dt / args.scale * (1.0 + DRIFT)
    steps = round(args.duration / rig.dt) if args.duration else math.inf
    rng, changes = random.Random(args.seed), sorted(args.at)
    actuators = [Actuator(actuation, rig.dt) for actuation in rig.actuations]
    commands, answered, k = [actuation.start for actuation in rig.actuations], -1, 0
    log = Log(args.log, rig.dt, rig.topics[1:]) if args.log else None
    while k < steps and not stop:
        t = k * rig.dt
        x, truth = rig.measure(t, rng)
        due = begin + (k + args.jitter * rng.random()) * period
        late = time.monotonic() - due
        if late < 0.0:
            time.sleep(-late)
        elif late > 1.0:  # was stopped or starved: time goes on from here
            begin += late
        # the rig's own clock: its start is real time, its seconds are a little too long
        applied = [actuator.theta for actuator in actuators]
        wire.say(round((wall + t) * 1e9), k, x, truth, applied, actuators[0].step)
        if log:
            log.add(t, applied, truth)
        for knob, wanted, step in wire.heard():
            if step is None:
                commands[knob] = wanted
            elif 0 <= k - step <= OLDEST * args.scale / rig.dt:  # not kept while a link was cut
                commands[knob], answered = wanted, step
        while changes and changes[0].time <= t:
            rig.set(*changes.pop(0)[1:])
        k += 1
        moves = zip(actuators, commands, strict=True)
        rig.advance(t, *(actuator.move(command, answered) for actuator, command in moves))
    time.sleep(0.2)  # a reliable writer's last samples are still on their way
    print(f"{k} steps in {time.monotonic() - begin:.2f} s", flush=True)


class TimedValue(NamedTuple):
    """A quantity that is set to a value at a time [s]."""

    time: float
    name: str
    value: float


def change(text: str) -> TimedValue:
    """Return the change that ``T:NAME=VALUE`` names.

    >>> change("60:throttle=0.9")
    TimedValue(time=60.0, name='throttle', value=0.9)
    """
    when, _, what = text.partition(":")
    name, _, value = what.partition("=")
    try:
        wanted = TimedValue(float(when), name, float(value))
    except ValueError:
        wanted = TimedValue(math.nan, "", math.nan)
    if not (name and wanted.time >= 0.0 and math.isfinite(wanted.value)):
        raise argparse.ArgumentTypeError(f"{text!r}: write T:NAME=VALUE, such as 60:throttle=0.9")
    return wanted


def options() -> argparse.ArgumentParser:
    """Return the options of every rig."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--duration", type=float, default=0.0, help="simulated seconds; 0: no limit"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="simulated per real time")
    parser.add_argument("--state", default="", help="topic of the measurements")
    parser.add_argument("--theta", default="", help="topic of the first knob's command")
    parser.add_argument(
        "--theta-initial", nargs="+", type=float, default=[], help="of one knob or more"
    )
    parser.add_argument("--jitter", type=float, default=0.1, help="of every period [periods]")
    parser.add_argument("--readers", type=int, default=1, help="of the measurements to wait for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--truth", action="store_true", help="also publish koop_msgs/PlantTruth on /ground_truth"
    )
    parser.add_argument("--log", metavar="FILE", help="true state of every second, as CSV")
    parser.add_argument("--until-eof", action="store_true", help="end when stdin is closed")
    parser.add_argument(
        "--at", action="append", type=change, default=[], metavar="T:NAME=VALUE",
        help="at this time [s] set what the rig has of that name; repeatable",
    )  # fmt: skip
    return parser


def start(args: argparse.Namespace, *usual: float) -> list[float]:
    """Return theta of each knob at first: what the command line says, the rest as usual."""
    if len(args.theta_initial) > len(usual):
        raise ValueError(f"--theta-initial: this rig has {len(usual)} knob{'s' * (len(usual) > 1)}")
    return [*args.theta_initial, *usual[len(args.theta_initial) :]]


def parse_rig(rigs: Any, name: str, text: str, make: Any) -> argparse.ArgumentParser:
    """Add a rig to the command line, which ``make`` makes of the arguments; return its parser."""
    parser: argparse.ArgumentParser = rigs.add_parser(name, parents=[options()], help=text)
    parser.set_defaults(make=make)
    return parser
