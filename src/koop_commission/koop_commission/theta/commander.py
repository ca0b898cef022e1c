"""Commands theta for a commissioning process, in a process of its own.

``python -m koop_commission.theta.commander``; the other side is
:mod:`koop_commission.theta.commander_client`. Lines of JSON on stdin name a target; theta moves to
it within limits and rate, and every state is answered as a controller answers it. Theta returns to
``theta_safe``, whatever the target was, when

- stdin closes or SIGTERM or SIGINT arrives: the command has ended, also by kill -9;
- no line arrives for a while: the command hangs;
- a channel is beyond its limit, or no usable message arrives any more;
- a controller that is followed falls silent.

While a controller is followed, each of its answers goes to the rig as it is, as far as limits and
rate allow. The process ends once theta is at ``theta_safe`` and stdin is closed. Lines of JSON on
stdout report theta.
"""

from __future__ import annotations

import json
import math
import os
import queue
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from koop_msgs.msg import ControlInput, MeasuredState
from rclpy.qos import QoSProfile

from koop_commission.rig.graph import identify_publishers
from koop_commission.theta.assignment import Assignment
from koop_commission.theta.limits import SAFETY, LimitedTheta, describe_violation
from koop_core.config.fields import parse_source, write_field
from koop_core.errors import KoopError
from koop_node.client.client import Client
from koop_node.node.adapter import StateAdapter
from koop_node.node.managed import message_type
from koop_node.node.qos import BEST_EFFORT, NEWEST, RELIABLE
from koop_tune.rig.rig_file import THETA

REPORT = 0.5  # [s] between two reports
REPORT_MOVING = 0.05  # [s]: if this process is killed, another goes on from the last theta reported
TICK = 0.02  # [s] between two commands where no state asks for one
LAG = 0.1  # [s] of states that wait to be answered


class Commander:
    """Theta within its limits, over DDS.

    Parameters
    ----------
    client : Client
        Node in the ROS domain.
    assignment : Assignment
        The rig, and how its theta is commanded.

    Attributes
    ----------
    theta : LimitedTheta
        Value and target.
    following : bool
        Whether a controller is followed.
    since : float
        Monotonic time at which states were first answered [s]; infinite before.
    step : int
        Step of the newest state; -1 before the first.
    """

    def __init__(self, client: Client, assignment: Assignment) -> None:
        rig = assignment.rig
        self._client, self._rig = client, rig
        self.assignment = assignment
        self.theta = LimitedTheta(rig, assignment.theta, assignment.theta)
        self._silence = SAFETY.silence(rig)
        self._source = parse_source(assignment.source or rig.measured)
        self._kind = message_type(assignment.kind or rig.measured_type)
        self._adapter = StateAdapter(self._source, rig.dt)
        self._counts_steps = self._kind is MeasuredState
        node = client.node
        self._answer = ControlInput(theta=self.theta.theta)
        self._answers = node.create_publisher(ControlInput, THETA, RELIABLE)
        self._command: Any = None
        self._message: Any = self._answer
        if not rig.takes_answers:
            kind = message_type(rig.command_type)
            self._message = self._answer if kind is ControlInput else kind()
            self._command = node.create_publisher(kind, rig.knob.topic, NEWEST)
        self._publishers: set[str] = set()
        self._arrived = self._usable = self._sent = self._moved = time.monotonic()
        self._begun = False
        self._wanted: float | None = None
        self.since = math.inf
        self.step = -1
        self._unusable: list[str] = []
        self.following, self._answered, self._followed = False, math.inf, -1
        if assignment.follows:
            node.create_subscription(ControlInput, assignment.follows, self._on_answer, NEWEST)

    def is_matched(self) -> bool:
        """Return whether rig and recorders subscribe."""
        needed = self.assignment.recorders + (self._command is None)
        return self._answers.get_subscription_count() >= needed and (
            self._command is None or self._command.get_subscription_count() >= 1
        )

    def listen(self) -> None:
        """Begin to answer states."""
        self._arrived = self._usable = self.since = time.monotonic()
        # on a busy machine states are left out, so that no answer is late by more than LAG
        like = RELIABLE if self._counts_steps else BEST_EFFORT
        depth = max(1, round(LAG * self._rig.pace / self._rig.dt))
        qos = QoSProfile(depth=depth, reliability=like.reliability)
        self._client.node.create_subscription(self._kind, self._source.topic, self._on_state, qos)

    def go(self, target: float) -> None:
        """Move theta to a target, once the rig receives."""
        self.following, self._wanted = False, target

    def follow(self) -> None:
        """Follow the controller, which begins at this theta."""
        self.following, self._followed = True, -1
        self._answered = time.monotonic() + SAFETY.hang - self._silence

    def give_up(self, reason: str) -> None:
        """Let theta return to theta_safe."""
        self.theta = self.theta.give_up(reason)

    def tick(self) -> None:
        """Detect silence, and command theta where no state asks for a command."""
        now = time.monotonic()
        if self._wanted is not None and now - self.since > SAFETY.matched:
            self.theta, self._wanted = self.theta.aim(self._wanted), None
        if (unusable := now - self._usable) > (self._silence if self._begun else SAFETY.first):
            topic = self._source.topic
            self.give_up(
                f"no message on {topic} for {unusable:.1f} s"
                if now - self._arrived > self._silence or not self._unusable
                else f"{', '.join(self._unusable)} on {topic} is not a number for {unusable:.1f} s"
            )
        if self.following and now - self._answered > self._silence:
            self.give_up(f"the controller is silent for {self._silence:.1f} s")
        period = self._rig.dt / self._rig.pace
        gap = max(TICK, 2.0 * period)
        if self.theta.reason and now - self._sent > gap:
            # of a time without a state, no more than passes between two ticks: theta never jumps
            self._moved = max(self._moved, now - 2.0 * gap)
            while now - self._moved > period and not self.theta.arrived:
                self._moved += period
                self.theta = self.theta.advance(self._rig.dt)
            self._publish(now)

    def identify_rig(self) -> None:
        """Note the rig's publishers, once there are any."""
        if not self._publishers:
            self._publishers = identify_publishers(self._client, self._rig.state.topic)

    def leave(self) -> None:
        """Note the value at which theta of which rig is left: the next command begins there."""
        if self.assignment.note:
            words = [repr(self.theta.theta), *sorted(self._publishers)]
            with suppress(OSError):
                Path(self.assignment.note).write_text(" ".join(words) + "\n")

    def _on_state(self, message: Any) -> None:
        now = self._arrived = time.monotonic()
        self._begun = True
        step, x = self._adapter.convert(message)
        if self._counts_steps:
            step = message.step
        self._unusable = [
            name for name, value in zip(self._rig.names, x, strict=False)
            if not math.isfinite(value)
        ]  # fmt: skip
        if not self._unusable:
            self._usable = now
            if violation := describe_violation(self._rig, x):
                self.give_up(violation)
        elapsed = (now - self._moved) * self._rig.pace
        if getattr(message, "lockstep", False):  # its time is counted in steps
            elapsed = (step - self.step) * self._rig.dt
        self.step, self._moved = step, now
        if hasattr(message, "header"):
            with suppress(AssertionError, TypeError):  # a package may have a header of its own
                self._answer.header = message.header
        if self.following and self._followed >= 0 and not self.theta.reason:
            return  # the controller answers
        self.theta = self.theta.advance(elapsed)
        self._publish(now)

    def _on_answer(self, answer: ControlInput) -> None:
        """Pass on an answer of the controller that is followed."""
        if not self.following or self.theta.reason or not math.isfinite(answer.theta):
            return
        ahead = answer.step - self._followed if self._followed >= 0 else 1
        self._answered, self._followed = time.monotonic(), answer.step
        self.theta = self.theta.aim(answer.theta).advance(max(ahead, 0) * self._rig.dt)
        answer.theta = self.theta.theta
        self._send(answer)

    def _publish(self, now: float) -> None:
        answer, rig = self._answer, self._rig
        answer.step, answer.theta = max(self.step, 0), self.theta.theta
        answer.holding = self.theta.arrived
        answer.saturated = not rig.theta_min < self.theta.theta < rig.theta_max
        self._send(answer)
        self._sent = now

    def _send(self, answer: ControlInput) -> None:
        self._answers.publish(answer)
        if self._command is None:
            return
        if isinstance(self._message, ControlInput):
            self._command.publish(answer)
        else:
            write_field(self._rig.knob.fields[0], self._message, answer.theta)
            self._command.publish(self._message)


class Lines:
    """Lines of stdin, read by a thread; None when it has closed."""

    def __init__(self) -> None:
        self.waiting: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="lines").start()

    def _read(self) -> None:
        rest = b""
        with suppress(OSError):
            while data := os.read(0, 65536):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self.waiting.put(line.decode())
        self.waiting.put(None)


def report(**values: Any) -> None:
    """Write a line to the command, if it still runs."""
    with suppress(OSError):
        os.write(1, json.dumps(values).encode() + b"\n")


def main() -> int:
    """Run until theta is at theta_safe and the command has ended; return the exit code."""
    signals: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    lines = Lines()
    first = lines.waiting.get()
    if first is None:
        return 0
    with Client("koop_commander") as client:
        try:
            commander = Commander(client, Assignment.from_json(json.loads(first)))
        except KoopError as error:
            report(error=str(error))
            return 2
        return _run(client, commander, lines, signals)


def _run(client: Client, commander: Commander, lines: Lines, signals: list[int]) -> int:
    begin = newest = time.monotonic()
    listening = closed = False
    reported: tuple[Any, ...] = ()
    when = safe_since = -math.inf
    while True:
        client.spin(TICK)
        now = time.monotonic()
        while not lines.waiting.empty():
            line, newest = lines.waiting.get(), now
            if line is None:
                closed = True
                commander.give_up("the command has ended")
                break
            _obey(commander, json.loads(line))
        if signals:
            closed = True
            commander.give_up("the commander was stopped by a signal")
        if now - newest > SAFETY.hang:
            commander.give_up(f"the command gave no sign of life for {SAFETY.hang:g} s")
        if listening:
            commander.tick()
        elif commander.is_matched():
            commander.listen()
            listening = True
        elif commander.theta.reason and not commander.assignment.rescue:
            return 0  # theta was never commanded
        elif now - begin > SAFETY.first:
            report(error=f"{commander.assignment.rig.knob.topic} has no subscriber")
            return 2
        theta = commander.theta
        news = (theta.arrived, None if commander.following else theta.target, theta.reason)
        resting = theta.arrived and not commander.following
        if news != reported or now - when > (REPORT if resting else REPORT_MOVING):
            reported, when = news, now
            commander.identify_rig()
            report(theta=theta.theta, arrived=theta.arrived, target=theta.target,
                   reason=theta.reason, step=commander.step)  # fmt: skip
        if not theta.safe:
            safe_since = now
        elif closed and min(now - safe_since - SAFETY.held,
                            now - commander.since - SAFETY.matched) > 0.0:  # fmt: skip
            commander.leave()
            return 0


def _obey(commander: Commander, line: dict[str, Any]) -> None:
    if "give_up" in line:
        commander.give_up(line["give_up"])
    elif "target" in line:
        commander.go(line["target"])
    elif "follow" in line:
        commander.follow()


if __name__ == "__main__":
    sys.exit(main())
