"""The hand on the knob: theta is moved by a process that takes it home if this one ends."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from koop_bringup.live.process import OWN_GROUP, uninterrupted
from koop_commission.theta.limits import way_home
from koop_core.errors import LiveError
from koop_loop.ending import told
from koop_tune.rig.rig_file import RigFile

BEAT = 1.0  # [s] between two signs of life
PATIENCE = 20.0  # [s] beyond the way home, after which the commander is given up
WORDS = [sys.executable, "-m", "koop_commission.theta.commander"]


class Hand:
    """A commander of theta; a context manager that leaves theta at its safe value.

    Parameters
    ----------
    rig : RigFile
        Limits, command, safe value.
    log : Path
        File for what the commander prints.
    source, kind : str, optional
        Where the states come from; default: the measured channels of the rig.
    scale : float
        The rig's seconds in one second.
    recorders : int
        Recorders that must listen to theta before it moves.
    note : Path, optional
        File for where theta is left.
    follows : str
        Topic of a controller, as koop_msgs/ControlInput.
    theta : float, optional
        Where it is now; default: as the rig file says.

    Attributes
    ----------
    theta : float
        Commanded now.
    home : str
        Why theta goes back to the safe value; empty: it does not.
    """

    def __init__(
        self,
        rig: RigFile,
        log: Path,
        source: str = "",
        kind: str = "",
        scale: float = 1.0,
        recorders: int = 0,
        note: Path | None = None,
        follows: str = "",
        theta: float | None = None,
    ) -> None:
        self.theta = self._target = rig.theta_start if theta is None else theta
        self._rig = rig
        self._log = log
        self._scale = scale
        self._first = {
            "rig": asdict(rig),
            "theta": self.theta,
            "source": source or rig.measured,
            "type": kind or rig.measured_type,
            "scale": scale,
            "recorders": recorders,
            "rescue": False,
            "note": str(note.resolve()) if note is not None else "",
            "follows": follows,
        }
        self.home = ""
        self._said: dict[str, Any] = {}
        self._error = ""
        self._beat = -math.inf

    def __enter__(self) -> Hand:
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
                self.come_home()
            finally:
                self._close()

    @uninterrupted()
    def come_home(self) -> None:
        """Take theta to its safe value and keep it there.

        Raises
        ------
        LiveError
            If it may not be there.
        """
        self._tell(home="the command ends")
        if self._comes_home():
            return
        # killed: another one takes theta home, from where it was last known to be
        self._close()
        self._first |= {"theta": self.theta, "recorders": 0, "rescue": True, "follows": ""}
        self._start()
        self._tell(home="the commander was killed")
        if not self._comes_home():
            raise LiveError(
                f"theta may be at {self.theta:g}, not at its safe value "
                f"{self._rig.theta_safe:g}: see {self._log}"
            )

    @property
    def step(self) -> int:
        """Step of the newest state that was answered; -1 before the first."""
        return int(self._said.get("step", -1))

    @property
    def there(self) -> bool:
        """Whether theta is where it was told to go."""
        return bool(self._said.get("there")) and self._said.get("target") == self._target

    def go(self, theta: float) -> None:
        """Let theta move to a value, within limits and rate."""
        self._target = min(max(theta, self._rig.theta_min), self._rig.theta_max)
        self._tell(target=theta)

    def follow(self) -> None:
        """Let a controller, which begins where theta is, move it from now on, until :meth:`go`."""
        self._target = math.nan
        self._tell(follow=True)

    def beat(self) -> None:
        """Give a sign of life.

        Raises
        ------
        LiveError
            If the commander takes theta home, or has ended.
        """
        if self.home:
            raise LiveError(self.home)
        if self._process.poll() is not None:
            words = self._error or told("the commander", self._process.returncode)
            raise LiveError(words)
        if time.monotonic() - self._beat > BEAT:
            self._tell()

    def _tell(self, **values: Any) -> None:
        self._beat = time.monotonic()
        with suppress(OSError, ValueError):  # that it has ended is found by the next look
            assert self._process.stdin is not None
            self._process.stdin.write(json.dumps(values).encode() + b"\n")
            self._process.stdin.flush()

    def _start(self) -> None:
        self._said, self._error, self.home = {}, "", ""
        with open(self._log, "ab") as output:
            self._process = subprocess.Popen(
                WORDS,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=output,
                env=os.environ,
                **OWN_GROUP,  # Ctrl-C reaches this process, which tells the commander
            )
        self._tell(**self._first)
        threading.Thread(target=self._listen, args=(self._process,), daemon=True).start()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            with suppress(ValueError):
                said = json.loads(line)
                self._error = said.get("error", self._error)
                if "theta" in said:
                    self._said, self.theta, self.home = said, said["theta"], said["home"]

    def _comes_home(self) -> bool:
        """Wait until theta is at its safe value, or was never commanded; return whether it is."""
        way = way_home(self._rig, self.theta) / self._scale
        deadline = time.monotonic() + way + PATIENCE
        while time.monotonic() < deadline:
            if self.home and self._said.get("there"):
                return True
            if (code := self._process.poll()) is not None:
                never = self._said.get("step", -1) < 0 and not self._first["rescue"]
                return never and code in (0, 2)
            self._tell()
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


def note_of(rig_file: str | Path) -> Path:
    """Return the file that says where theta of a rig was left."""
    path = Path(rig_file)
    return path.with_name(f".{path.name}.theta")


def left_at(note: Path | None, rig: RigFile, speakers: Collection[str]) -> tuple[float, str]:
    """Return where theta is, and what is to be said about it, if anything.

    It is where the last command left it, unless the rig was started again since, or nobody has
    moved it: then it is as the rig file says.

    Parameters
    ----------
    note : Path or None
        File that says where it was left.
    rig : RigFile
        The rig.
    speakers : collection of str
        Who says the measured channels now.
    """
    if note is not None:
        with suppress(OSError, ValueError):
            first, *known = note.read_text().split() or [""]
            theta = float(first)
            if known and speakers and not set(known) & set(speakers):
                return rig.theta_start, (
                    f"the rig was started again since theta was left at {theta:g}: it counts as "
                    f"theta_start = {rig.theta_start:g}"
                )
            if rig.theta_min <= theta <= rig.theta_max:
                return theta, ""
    return rig.theta_start, ""
