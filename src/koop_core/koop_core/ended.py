"""The note in the logs of a run that says how its loop ended. Pure: no ROS.

It is written at the start, so that a run without an end in it was killed as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from koop_core.whole_file import read_object, write_json

FILE = "ended.json"


@dataclass(frozen=True)
class Ended:
    """How a loop ended."""

    time: float = 0.0
    """When [s since the epoch]; 0: not yet, or it was killed."""
    failure: str = ""
    """Why it ended, in words; empty: in order."""
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
