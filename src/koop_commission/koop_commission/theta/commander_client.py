"""Moves theta through a commander process, which returns it to theta_safe if this one ends."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from koop_bringup.live.process import uninterrupted
from koop_commission.theta.assignment import Assignment
from koop_core.errors import LiveError
from koop_loop.ending import describe_end
from koop_node.process.lifeline import OWN_GROUP

SIGN_OF_LIFE = 1.0  # [s] between two lines to the commander
PATIENCE = 20.0  # [s] beyond the time to return, after which the commander is given up
WORDS = [sys.executable, "-m", "koop_commission.theta.commander"]


class CommanderClient:
    """A commander process; a context manager that leaves theta at theta_safe.

    Parameters
    ----------
    assignment : Assignment
        The rig, and how its theta is commanded.
    log : Path
        File for what the commander prints.

    Attributes
    ----------
    theta : float
        Commanded now.
    reason : str
        Why theta returns to theta_safe; empty: it does not.
    """

    def __init__(self, assignment: Assignment, log: Path) -> None:
        self._assignment, self._rig, self._log = assignment, assignment.rig, log
        self.theta = self._target = assignment.theta
        self.reason = ""
        self._report: dict[str, Any] = {}
        self._error = ""
        self._written = -math.inf

    def __enter__(self) -> CommanderClient:
        self._start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with uninterrupted():
            try:
                self.return_to_safe()
            finally:
                self._close()

    @uninterrupted()
    def return_to_safe(self) -> None:
        """Return theta to theta_safe and keep it there.

        Raises
        ------
        koop_core.errors.LiveError
            If it may not be there.
        """
        self._write(give_up="the command ends")
        if self._wait_until_safe():
            return
        # killed: another commander goes on, from the last theta known
        self._close()
        self._assignment = replace(
            self._assignment, theta=self.theta, recorders=0, follows="", rescue=True
        )
        self._start()
        self._write(give_up="the commander was killed")
        if not self._wait_until_safe():
            raise LiveError(
                f"theta may be at {self.theta:g}, not at theta_safe = {self._rig.theta_safe:g}: "
                f"see {self._log}"
            )

    @property
    def step(self) -> int:
        """Step of the newest state that was answered; -1 before the first."""
        return int(self._report.get("step", -1))

    @property
    def arrived(self) -> bool:
        """Whether theta is at the target of :meth:`go`."""
        return bool(self._report.get("arrived")) and self._report.get("target") == self._target

    def go(self, theta: float) -> None:
        """Move theta to a value, within limits and rate."""
        self._target = min(max(theta, self._rig.theta_min), self._rig.theta_max)
        self._write(target=theta)

    def follow(self) -> None:
        """Let the controller, which begins at this theta, move it until :meth:`go`."""
        self._target = math.nan
        self._write(follow=True)

    def check(self) -> None:
        """Give a sign of life.

        Raises
        ------
        koop_core.errors.LiveError
            If the commander returns theta to theta_safe, or has ended.
        """
        if self.reason:
            raise LiveError(self.reason)
        if self._process.poll() is not None:
            raise LiveError(self._error or describe_end("the commander", self._process.returncode))
        if time.monotonic() - self._written > SIGN_OF_LIFE:
            self._write()

    def _write(self, **values: Any) -> None:
        self._written = time.monotonic()
        with suppress(OSError, ValueError):  # check() detects that it has ended
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps(values).encode() + b"\n")
            self._process.stdin.flush()

    def _start(self) -> None:
        self._report, self._error, self.reason = {}, "", ""
        with open(self._log, "ab") as output:
            self._process = subprocess.Popen(
                WORDS,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                env=os.environ,
                **OWN_GROUP,  # Ctrl-C reaches this process, which tells the commander
            )
        self._write(**self._assignment.as_json())
        threading.Thread(target=self._read, args=(self._process,), daemon=True).start()

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            with suppress(ValueError):
                report = json.loads(line)
                self._error = report.get("error", self._error)
                if "theta" in report:
                    self._report, self.theta = report, report["theta"]
                    self.reason = report["reason"]

    def _wait_until_safe(self) -> bool:
        """Wait until theta is at theta_safe; return whether it is, or was never commanded."""
        deadline = time.monotonic() + self._rig.guard.return_time(self.theta) + PATIENCE
        while time.monotonic() < deadline:
            if self.reason and self._report.get("arrived"):
                return True
            if (code := self._process.poll()) is not None:
                never = self._report.get("step", -1) < 0 and not self._assignment.rescue
                return never and code in (0, 2)
            self._write()
            time.sleep(0.05)
        return False

    def _close(self) -> None:
        """End the commander."""
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
