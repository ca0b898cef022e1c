"""Commands theta for a commissioning process, in a process of its own.

``python -m koop_commission.theta.commander``; its other side is
:mod:`koop_commission.theta.commander_client`. It is told a target by a line on stdin and walks
there within limits and rate, answering every state as a controller does. It takes
theta to the safe value, whatever it was told, when

- its stdin closes or SIGTERM or SIGINT comes: whoever started it has ended, also by kill -9;
- a line has not come for a while: that process hangs;
- a channel is beyond its limit, or no usable message comes any more;
- a controller that it follows says nothing any more.

It may be told to follow a controller: then every answer of that one goes to the rig as it is, as
far as limits and rate allow. It ends when theta is there and nobody holds its stdin. Lines are
JSON, both ways.
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

from koop_commission.rig.listener import speakers
from koop_commission.theta.limits import Leash, beyond, silence
from koop_core.config.fields import Source, parse_source, write_field
from koop_node.client.client import Client
from koop_node.node.adapter import StateAdapter
from koop_node.node.managed import message_type
from koop_node.node.qos import BEST_EFFORT, NEWEST, RELIABLE
from koop_tune.rig.rig_file import THETA, RigFile

HANG = 30.0  # [s] without a line, after which whoever started it counts as hanging
TELL = 0.5  # [s] between two lines to it
TELL_MOVING = 0.05  # [s]: if this process is killed, another goes on from the theta told last
TICK = 0.02  # [s] between two commands where no state asks for one
HELD = 0.5  # [s] that the safe value is said again at least before the end
LISTENERS = 15.0  # [s] for a rig to be found, and for its first message
LAG = 0.1  # [s] of states that wait to be answered
HEARD = 2.0  # [s] after which a rig that is seen to listen hears; on a busy machine 1.4 s were seen


class Commander:
    """Theta on its leash, over DDS.

    Parameters
    ----------
    client : Client
        Guest in the ROS domain.
    given : mapping
        The first line: ``rig``, ``theta`` it begins with, ``source`` and ``type`` of the states,
        ``scale`` (the rig's seconds in one second), ``recorders`` that must listen to theta,
        ``rescue`` if another commander has moved theta before, ``note``: file for where it is left,
        ``follows``: topic of a controller, or empty.

    Attributes
    ----------
    following : bool
        Whether theta is that of the controller.
    """

    def __init__(self, client: Client, given: dict[str, Any]) -> None:
        rig = self.rig = RigFile(**given["rig"])
        self.leash = Leash(rig, given["theta"], given["theta"])
        self._client = client
        self._scale = float(given["scale"])
        self._silence = silence(rig.dt, self._scale)
        self._source: Source = parse_source(given["source"])
        self._kind = message_type(given["type"])
        self._adapter = StateAdapter(self._source, rig.dt)
        self._own = self._kind is MeasuredState
        node = client.node
        self._answer = ControlInput(theta=self.leash.theta)
        self._theta = node.create_publisher(ControlInput, THETA, RELIABLE)
        knob = rig.knob
        self._command: Any = None
        self._path = knob.fields[0]
        if not rig.takes_answers:
            kind = message_type(rig.command_type)
            self._message = kind()
            self._answers = kind is ControlInput
            self._command = node.create_publisher(kind, knob.topic, NEWEST)
        self.rescue = bool(given["rescue"])
        self._note = given["note"]
        self._speakers: set[str] = set()
        self._needed = [(self._theta, int(given["recorders"]) + (self._command is None))]
        if self._command is not None:
            self._needed.append((self._command, 1))
        self._heard = self._usable = self._sent = self._moved = time.monotonic()
        self._begun = False
        self._wanted: float | None = None
        self.since = math.inf
        self.step = -1
        self._lacks: list[str] = []
        self.following, self._answered, self._last = False, math.inf, -1
        self._follows = str(given["follows"])
        if self._follows:
            node.create_subscription(ControlInput, self._follows, self._on_answer, NEWEST)

    def matched(self) -> bool:
        """Return whether all that must listen do."""
        return all(publisher.get_subscription_count() >= n for publisher, n in self._needed)

    def listen(self) -> None:
        """Begin to answer states."""
        self._heard = self._usable = self.since = time.monotonic()
        # on a busy machine it leaves out states, so that it is never late by more than LAG
        like = RELIABLE if self._own else BEST_EFFORT
        depth = max(1, round(LAG * self._scale / self.rig.dt))
        qos = QoSProfile(depth=depth, reliability=like.reliability)
        self._client.node.create_subscription(self._kind, self._source.topic, self._on_state, qos)

    def _on_state(self, message: Any) -> None:
        now = self._heard = time.monotonic()
        self._begun = True
        step, x = self._adapter.convert(message)
        if self._own:
            step = message.step
        self._lacks = [
            name for name, value in zip(self.rig.names, x, strict=False) if not math.isfinite(value)
        ]
        if not self._lacks:
            self._usable = now
            if problem := beyond(self.rig, x):
                self.leash = self.leash.called_home(problem)
        elapsed = (now - self._moved) * self._scale
        if getattr(message, "lockstep", False):  # its time is that of its steps
            elapsed = (step - self.step) * self.rig.dt
        self.step, self._moved = step, now
        if hasattr(message, "header"):
            with suppress(AssertionError, TypeError):  # a package may have a header of its own
                self._answer.header = message.header
        if self.following and self._last >= 0 and not self.leash.home:
            return  # the controller answers
        self.leash = self.leash.moved(elapsed)
        self._publish(now)

    def _on_answer(self, answer: ControlInput) -> None:
        """Let theta be what a controller says."""
        if not self.following or self.leash.home or not math.isfinite(answer.theta):
            return
        ahead = answer.step - self._last if self._last >= 0 else 1
        self._answered, self._last = time.monotonic(), answer.step
        self.leash = self.leash.asked(answer.theta).moved(max(ahead, 0) * self.rig.dt)
        answer.theta = self.leash.theta
        self._send(answer)

    def follow(self) -> None:
        """Let the controller move theta, which is where that one begins."""
        self.following, self._last = True, -1
        self._answered = time.monotonic() + HANG - self._silence

    def go(self, target: float) -> None:
        """Move theta to a target, once the rig hears."""
        self.following, self._wanted = False, target

    def _publish(self, now: float) -> None:
        answer = self._answer
        answer.step, answer.theta = max(self.step, 0), self.leash.theta
        answer.holding = self.leash.there
        rig = self.rig
        answer.saturated = not rig.theta_min < self.leash.theta < rig.theta_max
        self._send(answer)
        self._sent = now

    def _send(self, answer: ControlInput) -> None:
        self._theta.publish(answer)
        if self._command is not None:
            if self._answers:
                self._command.publish(answer)
            else:
                write_field(self._path, self._message, answer.theta)
                self._command.publish(self._message)

    def tick(self) -> None:
        """Find silence, and go on where no state asks for a command."""
        now = time.monotonic()
        if self._wanted is not None and now - self.since > HEARD:
            self.leash, self._wanted = self.leash.asked(self._wanted), None
        if now - self._usable > (self._silence if self._begun else LISTENERS):
            topic, seconds = self._source.topic, now - self._usable
            self.leash = self.leash.called_home(
                f"no message on {topic} for {seconds:.1f} s"
                if now - self._heard > self._silence or not self._lacks
                else f"{', '.join(self._lacks)} on {topic} is not a number for {seconds:.1f} s"
            )
        if self.following and now - self._answered > self._silence:
            self.leash = self.leash.called_home(
                f"the controller has said nothing for {self._silence:.1f} s"
            )
        period = self.rig.dt / self._scale
        gap = max(TICK, 2.0 * period)
        if self.leash.home and now - self._sent > gap:
            # of a time without a state, no more than passes between two ticks: theta never jumps
            self._moved = max(self._moved, now - 2.0 * gap)
            while now - self._moved > period and not self.leash.there:
                self._moved += period
                self.leash = self.leash.moved(self.rig.dt)
            self._publish(now)

    def know_rig(self) -> None:
        """Learn who the rig is, as long as nobody is known."""
        if not self._speakers:
            self._speakers = speakers(self._client, self.rig.state.topic)

    def leave(self) -> None:
        """Note where theta of which rig is left: who commands it next begins there."""
        if self._note:
            words = [repr(self.leash.theta), *sorted(self._speakers)]
            with suppress(OSError):
                Path(self._note).write_text(" ".join(words) + "\n")


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


def tell(**values: Any) -> None:
    """Write a line to whoever started this process, if it is still there."""
    with suppress(OSError):
        os.write(1, json.dumps(values).encode() + b"\n")


def main() -> int:
    """Run until theta is safe and nobody needs it any more; return the exit code."""
    asked: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        asked.append(number)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    lines = Lines()
    first = lines.waiting.get()
    if first is None:
        return 0
    with Client("koop_commander") as client:
        try:
            commander = Commander(client, json.loads(first))
        except ValueError as error:
            tell(error=str(error))
            return 2
        return _run(client, commander, lines, asked)


def _run(client: Client, commander: Commander, lines: Lines, asked: list[int]) -> int:
    begin = heard = time.monotonic()
    listening = closed = False
    told: tuple[Any, ...] = ()
    when = safe_since = -math.inf
    while True:
        client.spin(TICK)
        now = time.monotonic()
        while not lines.waiting.empty():
            line, heard = lines.waiting.get(), now
            if line is None:
                closed = True
                commander.leash = commander.leash.called_home("the command has ended")
                break
            said = json.loads(line)
            if "home" in said:
                commander.leash = commander.leash.called_home(said["home"])
            elif "target" in said:
                commander.go(said["target"])
            elif "follow" in said:
                commander.follow()
        if asked:
            closed = True
            commander.leash = commander.leash.called_home("the commander was told to stop")
        if now - heard > HANG:
            commander.leash = commander.leash.called_home(
                f"the command has said nothing for {HANG:g} s"
            )
        if not listening:
            if commander.matched():
                commander.listen()
                listening = True
            elif commander.leash.home and not commander.rescue:
                return 0  # theta was never commanded
            elif now - begin > LISTENERS:
                tell(error=f"nobody listens to {commander.rig.knob.topic}")
                return 2
        else:
            commander.tick()
        leash = commander.leash
        news = (leash.there, None if commander.following else leash.target, leash.home)
        resting = leash.there and not commander.following
        if news != told or now - when > (TELL if resting else TELL_MOVING):
            told, when = news, now
            commander.know_rig()
            tell(theta=leash.theta, there=leash.there, target=leash.target, home=leash.home,
                 step=commander.step)  # fmt: skip
        if not leash.safe:
            safe_since = now
        elif closed and min(now - safe_since - HELD, now - commander.since - HEARD) > 0.0:
            commander.leave()
            return 0


if __name__ == "__main__":
    sys.exit(main())
