"""The user's program that runs at each trip, beside the guard: nothing waits for it."""

from __future__ import annotations

import os
import shlex
import subprocess
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import IO

from koop_guard.config import SAFETY, GuardConfig
from koop_guard.guard import Trip
from koop_guard.node.memory_file import open_memory_file
from koop_node.process.lifeline import VARIABLE

MOST = 1_000_000  # [B] that a program says, beyond which it is forgotten: it is in memory
OF_US = (VARIABLE, "NOTIFY_SOCKET")  # in the environment, not for others


class Alarm:
    """Runs ``on_alarm`` once a trip, and says in a line to ``report`` if it failed."""

    def __init__(self, config: GuardConfig, report: Callable[[str], object]) -> None:
        self._config, self._report = config, report
        self._trip: Trip | None = None
        self._running: list[tuple[subprocess.Popen[bytes], float, IO[bytes]]] = []

    def start(self, trip: Trip, node: str) -> None:
        """Start the program, unless it was started for this trip; ``node`` is the guard's name."""
        config = self._config
        if not config.on_alarm or trip is self._trip:
            return
        self._trip = trip
        ago = time.monotonic() - trip.when
        facts = {
            "CAUSE": trip.cause.value,
            "REASON": trip.reason,
            "TIME": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time() - ago)),
            "THETA": _join(trip.theta),
            "THETA_SAFE": _join(config.each("theta_safe")),
            "X": _join(trip.x),
            "NODE": node,
            "COMMAND": config.command,
        }
        environment = {name: value for name, value in os.environ.items() if name not in OF_US}
        environment |= {f"KOOP_ALARM_{name}": value for name, value in facts.items()}
        try:
            said = open_memory_file("on_alarm")  # a pipe would fill up
            process = subprocess.Popen(
                shlex.split(config.on_alarm), env=environment, stdin=subprocess.DEVNULL,
                stdout=said, stderr=said, start_new_session=True,
            )  # fmt: skip
        except (OSError, ValueError) as error:
            self._report(f"on_alarm = {config.on_alarm!r} was not started: {error}")
            return
        with suppress(OSError):  # not at the guard's own priority
            os.sched_setscheduler(process.pid, os.SCHED_OTHER, os.sched_param(0))
        self._running.append((process, time.monotonic(), said))

    def check(self) -> None:
        """Look after programs that run: one that failed, or takes too long, is reported."""
        for running in list(self._running):
            process, since, said = running
            seconds = time.monotonic() - since
            if process.poll() is None:
                if os.fstat(said.fileno()).st_size > MOST:  # both write from the same place
                    said.seek(0)
                    said.truncate()
                if seconds < SAFETY.alarm:
                    continue
                process.kill()
                process.wait()
            self._running.remove(running)
            with said:
                said.seek(0)
                *_, last = ["", *said.read().decode(errors="replace").splitlines()]
            if code := process.returncode:
                end = f"exit code {code}" if code > 0 else f"signal {-code}"
                text = f"failed: {end} after {seconds:.1f} s: {last or 'it said nothing'}"
                self._report(f"on_alarm = {self._config.on_alarm!r} {text}")


def _join(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)
