"""The test stand of a simulated rig: its clock, its actuator, and its exchange of messages."""

from __future__ import annotations

import argparse
import math
import random
import signal
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

INSTALL = "pip install --no-deps -r requirements/plants.txt"  # plants of others
SHORTEST = 0.02  # [s] between two looks for listeners
DRIFT = 200e-6  # of the rig's clock [s/s]
OLDEST = 0.5  # age of the state behind a command, beyond which it is ignored [s of real time]


class Knob(NamedTuple):
    """What moves theta.

    Attributes
    ----------
    start, low, high : float
        Theta at first, and its stroke.
    delay, rate : float
        A command acts so late [s]; largest change a second, 0: none.
    """

    start: float
    low: float
    high: float
    delay: float = 0.0
    rate: float = 0.0


class Actuator:
    """Follows the command late, no faster than it can, within its stroke."""

    def __init__(self, knob: Knob, dt: float) -> None:
        self.theta, self.step = knob.start, -1
        self._knob = knob
        self._commands = deque([(knob.start, -1)] * (round(knob.delay / dt) + 1))
        self._most = knob.rate * dt if knob.rate > 0.0 else math.inf

    def move(self, command: float, step: int) -> float:
        """Return theta for the next step, given a command and the step that it answers."""
        self._commands.append((min(max(command, self._knob.low), self._knob.high), step))
        wanted, self.step = self._commands.popleft()
        change = wanted - self.theta
        self.theta += min(max(change, -self._most), self._most)
        return self.theta


class Stand:
    """Runs a rig at its own pace, with its own clock.

    Parameters
    ----------
    args : argparse.Namespace
        Of :func:`options`.
    wire : Wire
        Its topics.
    dt : float
        Time between two samples [s].
    knob : Knob
        What moves theta.
    """

    def __init__(self, args: argparse.Namespace, wire: Any, dt: float, knob: Knob) -> None:
        self._args, self._wire, self._dt = args, wire, dt
        self.rng = random.Random(args.seed)
        self._actuator = Actuator(knob, dt)
        self._command, self._answered = knob.start, -1
        self.steps = 0
        self._most = round(args.duration / dt) if args.duration else math.inf
        self._period = dt / args.scale * (1.0 + DRIFT)
        self._oldest = OLDEST * args.scale / dt  # [steps]
        self._stop: list[object] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self._stop.append(True))

    def stop(self) -> None:
        """End it at the next sample; from any thread."""
        self._stop.append(True)

    def wait(self) -> None:
        """Wait for the readers of the measurements."""
        while self._wire.readers < self._args.readers and not self._stop:
            time.sleep(SHORTEST)
        print("connected", flush=True)
        self._started, self._wall = time.monotonic(), time.time()

    @property
    def t(self) -> float:
        """Time of the next sample [s]."""
        return self.steps * self._dt

    def exchange(self, x: Sequence[float], truth: Sequence[float]) -> float | None:
        """Publish a sample when its time has come; return theta until the next, None at the end."""
        if self.steps >= self._most or self._stop:
            time.sleep(0.2)  # a reliable writer's last samples are still on their way
            took = time.monotonic() - self._started
            print(f"{self.steps} steps in {took:.2f} s", flush=True)
            return None
        k = self.steps
        due = self._started + (k + self._args.jitter * self.rng.random()) * self._period
        now = time.monotonic()
        if now < due:
            time.sleep(due - now)
        elif now > due + 1.0:  # was stopped or starved: time goes on from here
            self._started += now - due
        # the rig's own clock: its start is real time, its seconds are a little too long
        stamp = round((self._wall + self.t) * 1e9)
        actuator = self._actuator
        self._wire.say(stamp, k, x, truth, actuator.theta, actuator.step)
        for theta, step in self._wire.heard():
            if step is None:
                self._command = theta
            elif 0 <= k - step <= self._oldest:  # not what was kept while a link was cut
                self._command, self._answered = theta, step
        self.steps += 1
        return actuator.move(self._command, self._answered)


class Change(NamedTuple):
    """What is set to a value at a time [s]."""

    time: float
    name: str
    value: float


def change(text: str) -> Change:
    """Return the change that ``T:NAME=VALUE`` names, or ``NAME=VALUE`` for the start.

    >>> change("60:throttle=0.9")
    Change(time=60.0, name='throttle', value=0.9)
    """
    when, colon, what = text.partition(":")
    name, equals, value = (what if colon else text).partition("=")
    try:
        found = Change(float(when) if colon else 0.0, name.strip(), float(value))
    except ValueError:
        found = Change(math.nan, "", 0.0)
    if not (name and equals and math.isfinite(found.value) and found.time >= 0.0):
        raise argparse.ArgumentTypeError(
            f"{text!r}: write TIME:NAME=VALUE, such as 60:throttle=0.9"
        )
    return found


class Schedule:
    """Changes in the order of their times.

    Parameters
    ----------
    changes : sequence of Change
        In any order.
    """

    def __init__(self, changes: Sequence[Change]) -> None:
        self._left = sorted(changes, key=lambda change: change.time)

    def due(self, t: float) -> list[Change]:
        """Return, once each, the changes that are due by a time [s]."""
        count = sum(change.time <= t for change in self._left)
        now, self._left = self._left[:count], self._left[count:]
        return now


def options() -> argparse.ArgumentParser:
    """Return the options of every rig."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--duration", type=float, default=0.0, help="simulated seconds; 0: no limit"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="simulated per real time")
    parser.add_argument("--state", default="", help="topic of the measurements")
    parser.add_argument("--theta", default="", help="topic of the command")
    parser.add_argument("--theta-initial", type=float)
    parser.add_argument("--jitter", type=float, default=0.1, help="of every period [periods]")
    parser.add_argument("--readers", type=int, default=1, help="of the measurements to wait for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--truth", action="store_true", help="also publish koop_msgs/PlantTruth on /ground_truth"
    )
    parser.add_argument("--until-eof", action="store_true", help="end when stdin is closed")
    return parser
