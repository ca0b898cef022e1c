"""The note in the logs of a run that says how its loop ended. Pure: no ROS.

It is written at the start, so that a run without an end in it was killed as a whole.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from koop_core.whole_file import read_object, write_json

FILE = "ended.json"
PATH = "KOOP_ENDED"
"""In the environment of a process: where who started it says why the loop ends. In memory: a
process that returns theta must not wait for a disk."""
IN_ORDER = "the loop ends"
GUARD_IN_ORDER = "the guard ends"  # alone, as when it is deactivated
KILLED = "the process that started the loop was killed"


@dataclass(frozen=True)
class Ended:
    """How a loop ended."""

    time: float = 0.0
    """When [s since the epoch]; 0: not yet, or it was killed."""
    failure: str = ""
    """Why it ended, in words; empty: in order, or it has no time yet."""
    theta: str = ""
    """Where theta of a guarded rig was left, in words."""
    lost: tuple[tuple[float, str], ...] = ()
    """Nodes that ended while it went on: when, and how in words."""


def note_end(logs: Path, ended: Ended) -> None:
    """Write the note. Raises LiveError if that cannot be, as on a full disk."""
    write_json(logs / FILE, ended)


def read_end(logs: Path) -> Ended | None:
    """Return the note; None where none was written. Raises ConfigError if it is damaged."""
    return read_object(logs / FILE, Ended)


class Told:
    """Why the loop ends, as who started this process says it."""

    def __init__(self) -> None:
        self._parent, self._file = os.getppid(), -1
        try:
            self._file = os.open(os.environ.get(PATH, ""), os.O_RDONLY | os.O_CLOEXEC)
        except OSError:  # nobody says it
            return

    def why(self) -> str:
        """Return it in words; that it ends, if nothing is known."""
        said = os.pread(self._file, 1000, 0).decode(errors="replace") if self._file >= 0 else ""
        killed = self._file >= 0 and os.getppid() != self._parent
        return said or (KILLED if killed else IN_ORDER)

    def close(self) -> None:
        """Hear it no longer."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1
