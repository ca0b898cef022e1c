"""The guard's twin: a process that takes over when the guard is killed.

The guard writes theta into memory that both share, and holds the other end of the twin's stdin.
When that closes before the guard has said that it is done, the twin returns theta to theta_safe
from the last theta commanded, within the rate, and ends. It has joined the ROS domain long before,
but publishes only then: nothing shows a second commander. A guard that gives no sign of life, as
one that was stopped, is killed first.
"""

from __future__ import annotations

import json
import mmap
import os
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from koop_core.config.knobs import MOST
from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Cause, Guard
from koop_guard.node.memory_file import open_memory_file
from koop_guard.note import NOT_NOTED, STOOD_STILL, TWIN, Note, leave, read
from koop_node.client.alone import claimed
from koop_node.process.lifeline import OWN_GROUP, VARIABLE

PROGRAM = (
    "import sys; from koop_guard.node.twin import main; "
    "from koop_node.process.ending import end_process; end_process(main(int(sys.argv[1])))"
)
LOOK = 0.25  # [s] between two looks for a sign of life
# theta, its knobs, sign of life [s], whether commanded, step, its time [s]
_WRITTEN = struct.Struct(f"<{MOST}dqdqqd")
_SIZE = _WRITTEN.size + 1  # and whether the twin is ready


class SharedTheta:
    """Theta in memory that guard and twin share; written at each command, without a system call."""

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, _SIZE)

    def write(
        self, theta: Sequence[float], now: float, commanded: bool, last: tuple[int, float]
    ) -> None:
        """Write theta, a sign of life, whether the twin is to take over, and the newest step."""
        n = len(theta)
        unused = (0.0,) * (MOST - n)
        _WRITTEN.pack_into(self._memory, 0, *theta, *unused, n, now, commanded, *last)

    def read(self) -> tuple[tuple[float, ...], float, bool, tuple[int, float]]:
        """Return what was last written."""
        *theta, n, alive, commanded, step, came = _WRITTEN.unpack_from(self._memory)
        return tuple(theta[:n]), alive, bool(commanded), (step, came)

    @property
    def ready(self) -> bool:
        """Whether the twin can take over."""
        return bool(self._memory[_WRITTEN.size])

    @ready.setter
    def ready(self, value: bool) -> None:
        self._memory[_WRITTEN.size] = value


class Twin:
    """The twin, seen from the guard; it is ready a while after :meth:`prepare`."""

    def __init__(self) -> None:
        with open_memory_file("theta") as file:
            file.truncate(_SIZE)
            self.shared = SharedTheta(file.fileno())
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, str(file.fileno())],
                stdin=subprocess.PIPE,
                pass_fds=[file.fileno()],
                env={name: value for name, value in os.environ.items() if name != VARIABLE},
                **OWN_GROUP,  # Ctrl-C reaches the guard, which lets it go
            )
        self._begun = time.monotonic()

    def hangs(self, now: float) -> bool:
        """Return whether it should be ready by now [s], and is not."""
        return not self.shared.ready and now - self._begun > SAFETY.first

    def prepare(
        self, config: dict[str, Any], topics: list[str], kinds: Sequence[str], measured: str
    ) -> None:
        """Say what it may have to command: full names and message types of the command.

        ``config`` has the values of the guard's, ``measured`` is the topic of the rig's channels.
        """
        order = {"config": config, "topics": topics, "kinds": kinds, "measured": measured}
        with suppress(OSError):
            assert self.process.stdin is not None
            self.process.stdin.write(json.dumps(order).encode() + b"\n")
            self.process.stdin.flush()

    def release(self, theta: Sequence[float]) -> None:
        """Let it go: theta is where it is to be."""
        self.shared.write(theta, time.monotonic(), False, (0, 0.0))
        with suppress(OSError):
            assert self.process.stdin is not None
            self.process.stdin.close()
        try:
            self.process.wait(SAFETY.first)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def main(descriptor: int) -> int:
    """Wait for the guard's end; return theta to theta_safe if it was killed."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    guard_id = os.getppid()
    shared = SharedTheta(descriptor)
    from koop_node.client.client import Client

    with claimed(f"{TWIN}{guard_id}"), Client("_koop_guard_twin") as client:
        if not (line := sys.stdin.buffer.readline()):
            return 0
        order = json.loads(line)
        shared.ready = True
        still = Stillness()
        why = "the guard was killed"
        while not _has_ended():
            client.spin(0.0)  # what was discovered
            _, alive, commanded, _ = shared.read()
            if still.look(alive, commanded) > SAFETY.stopped:
                why = f"{STOOD_STILL} {SAFETY.stopped:g} s: its twin ended it"
                print(why, flush=True)  # first: who waits for the guard's end looks for it
                with suppress(ProcessLookupError):
                    os.kill(guard_id, signal.SIGKILL)
        theta, _, commanded, last = shared.read()
        if commanded:
            _take_over(client, order, theta, last, why)
    return 0


class Stillness:
    """How long the guard has given no sign of life, in the twin's own looks.

    A machine that was paused wakes both: the time of the pause is nobody's.
    """

    def __init__(self) -> None:
        self._alive, self._looks = 0.0, 0

    def look(self, alive: float, commanded: bool) -> float:
        """Return the time [s] since the last sign of life, which was at ``alive``."""
        same = commanded and alive == self._alive
        self._alive, self._looks = alive, self._looks + 1 if same else 0
        return self._looks * LOOK


def _has_ended() -> bool:
    """Wait a moment for the end of the guard."""
    return bool(select.select([sys.stdin], [], [], LOOK)[0]) and not os.read(0, 1024)


def _take_over(
    client: Any, order: dict[str, Any], theta: Sequence[float], last: tuple[int, float], why: str
) -> None:
    """Return theta to theta_safe, as long as the rig is there; ``why`` the guard does not."""
    from koop_guard.node.alarm import Alarm
    from koop_guard.node.wire import Command, describe_theta, return_to_safe
    from koop_node.node.graph import identify_publishers

    config = GuardConfig(**order["config"])
    topics = zip(config.commands, order["topics"], strict=True)
    sources = [source._replace(topic=topic) for source, topic in topics]
    command = Command(client.node.create_publisher, sources, order["kinds"])
    guard = Guard(config, theta)
    guard.note(Cause.ENDED, why, time.monotonic())
    alarm = Alarm(config, print)
    assert guard.trip is not None
    alarm.start(guard.trip, "the guard's twin")
    return_to_safe(guard, config, command, guard.advance, last)
    alarm.check()
    # with the trip that it may hold
    note = read(config.note) or Note(guard.theta, config.command, (), None, 0)
    publishers = identify_publishers(client.node, order["measured"]) or note.publishers
    note = replace(note, theta=guard.theta, publishers=tuple(sorted(publishers)))
    if failure := leave(config.note, note):
        print(f"{NOT_NOTED}: {failure}", flush=True)
    print(f"{why}; {describe_theta(guard, config)}", flush=True)
