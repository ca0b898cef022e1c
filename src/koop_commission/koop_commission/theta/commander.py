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
from types import FrameType
from typing import Any

from koop_msgs.msg import ControlInput, MeasuredState
from rclpy.qos import QoSProfile

from koop_commission.rig.graph import identify_publishers
from koop_commission.theta.assignment import Assignment
from koop_core.config.fields import parse_source, write_field
from koop_core.errors import KoopError
from koop_guard.config import SAFETY
from koop_guard.guard import Cause, Guard
from koop_guard.note import leave
from koop_node.client.client import Client
from koop_node.node.adapter import StateAdapter
from koop_node.node.managed import message_type
from koop_node.node.qos import BEST_EFFORT, NEWEST, RELIABLE
from koop_tune.rig.rig_file import THETA

REPORT = 0.5  # [s] between two reports
REPORT_MOVING = 0.05  # [s]: if this process is killed, another goes on from the last theta reported
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
    guard : Guard
        Value and target of theta, and why it returns.
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
        self.guard = Guard(rig.guard, assignment.theta)
        self._period = rig.dt / rig.pace  # [s] by the clock on the wall
        self._source = parse_source(assignment.source)
        self._kind = message_type(assignment.state_type)
        self._adapter = StateAdapter(self._source, rig.dt)
        self._counts_steps = self._kind is MeasuredState
        node = client.node
        self._answer = ControlInput(theta=self.guard.theta)
        self._answers = node.create_publisher(ControlInput, THETA, RELIABLE)
        self._command: Any = None
        kind = message_type(assignment.command_type)
        self._message: Any = self._answer if kind is ControlInput else kind()
        if rig.knob.topic != THETA or kind is not ControlInput:  # else it takes the answers
            self._command = node.create_publisher(kind, rig.knob.topic, NEWEST)
        self._publishers: set[str] = set()
        self._sent = self._moved = time.monotonic()
        self._begun = False
        self._wanted: float | None = None
        self.since = math.inf
        self.step = -1
        self.following, self._followed = False, -1
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
        self.since = time.monotonic()
        # on a busy machine states are left out, so that no answer is late by more than LAG
        like = RELIABLE if self._counts_steps else BEST_EFFORT
        depth = max(1, round(LAG / self._period))
        qos = QoSProfile(depth=depth, reliability=like.reliability)
        self._client.node.create_subscription(self._kind, self._source.topic, self._on_state, qos)

    def go(self, target: float) -> None:
        """Move theta to a target, once the rig receives."""
        self.following, self._wanted = False, target

    def follow(self) -> None:
        """Follow the controller, which begins at this theta."""
        self.following, self._followed = True, -1
        self._wanted = None
        self.guard.follow(time.monotonic() + SAFETY.hang)

    def give_up(self, reason: str) -> None:
        """Let theta return to theta_safe."""
        self.guard.note(Cause.ASKED, reason, time.monotonic())

    def tick(self) -> None:
        """Detect silence, and command theta where no state asks for a command."""
        now = time.monotonic()
        guard, gap = self.guard, max(SAFETY.tick, 2.0 * self._period)
        if self._wanted is not None and now - self.since > SAFETY.matched:
            guard.go(self._wanted)
            self._wanted = None
        guard.hear_time(now)
        if not self._begun and now - self.since > SAFETY.first:
            text = f"no message on {self._source.topic} for {now - self.since:.1f} s"
            guard.note(Cause.RIG_SILENT, text, now)
        if guard.reason and now - self._sent > gap:
            # of a time without a state, no more than passes between two ticks: theta never jumps
            guard.move(min(now - self._moved, 2.0 * gap))
            self._moved = now
            self._publish(now)

    def identify_rig(self) -> None:
        """Note the rig's publishers, once there are any."""
        if not self._publishers:
            self._publishers = identify_publishers(self._client, self._rig.state.topic)

    def leave(self) -> None:
        """Note the value at which theta of which rig is left: the next command begins there."""
        leave(self.assignment.note, self.guard.theta, self._publishers)

    def _on_state(self, message: Any) -> None:
        now = time.monotonic()
        self._begun = True
        step, x = self._adapter.convert(message)
        if self._counts_steps:
            step = message.step
        self.guard.hear_state(x, now)
        elapsed = now - self._moved
        if getattr(message, "lockstep", False):  # its time is counted in steps
            elapsed = (step - self.step) * self._period
        self.step, self._moved = step, now
        if hasattr(message, "header"):
            with suppress(AssertionError, TypeError):  # a package may have a header of its own
                self._answer.header = message.header
        if self.following and self._followed >= 0 and not self.guard.reason:
            return  # the controller answers
        self.guard.move(elapsed)
        self._publish(now)

    def _on_answer(self, answer: ControlInput) -> None:
        """Pass on an answer of the controller that is followed."""
        if not self.following or self.guard.reason or not math.isfinite(answer.theta):
            return
        ahead = answer.step - self._followed if self._followed >= 0 else 1
        self._followed = answer.step
        self.guard.hear_answer(answer.theta, answer.saturated, time.monotonic())
        answer.theta = self.guard.move(max(ahead, 0) * self._period)
        self._send(answer)

    def _publish(self, now: float) -> None:
        answer, rig = self._answer, self._rig
        answer.step, answer.theta = max(self.step, 0), self.guard.theta
        answer.holding = self.guard.arrived
        answer.saturated = not rig.theta_min < self.guard.theta < rig.theta_max
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
        client.spin(SAFETY.tick)
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
        elif commander.guard.reason and not commander.assignment.rescue:
            return 0  # theta was never commanded
        elif now - begin > SAFETY.first:
            report(error=f"{commander.assignment.rig.knob.topic} has no subscriber")
            return 2
        guard = commander.guard
        news = (guard.arrived, None if commander.following else guard.target, guard.reason)
        resting = guard.arrived and not commander.following
        if news != reported or now - when > (REPORT if resting else REPORT_MOVING):
            reported, when = news, now
            commander.identify_rig()
            report(theta=guard.theta, arrived=guard.arrived, target=guard.target,
                   reason=guard.reason, step=commander.step)  # fmt: skip
        if not guard.at_safe:
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
