"""The file that notes what a guard leaves behind: where theta of a rig is, and a trip. Pure."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from koop_core.config.knobs import format_knobs
from koop_core.config.objects import parse, to_json
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_core.whole_file import read_json, write_json
from koop_guard.config import RigLimits
from koop_guard.guard import Trip

THETA_LEFT = "theta is left at"  # begins the last words of guard and twin
STOOD_STILL = "the guard stood still for"  # begins the words of a twin that ended its guard
NOT_NOTED = "where theta is cannot be noted, a restart would not know it"
TWIN = "koop_guard_twin/"  # begins the name that a twin holds; its guard's process ends it
PERIOD = 1.0  # [s] between two notes while nothing trips


@dataclass(frozen=True)
class Note:
    """What is noted of a rig."""

    theta: tuple[float, ...]
    """Commanded last, a value for each knob."""
    command: str
    """What takes it, as topic:field."""
    publishers: tuple[str, ...]
    """Ids of the rig's publishers."""
    trip: Trip | None
    """What holds theta at theta_safe until a rearm; its time is the system clock's [s]."""
    rearmed: int
    """Automatic rearms since the last one by hand."""


def note_of(rig_file: str | Path) -> Path:
    """Return the file that notes the value at which theta of a rig was left."""
    path = Path(rig_file)
    return path.with_name(f".{path.name}.theta")


def leave(path: Path | str | None, note: Note) -> str:
    """Write a note; return in words why that could not be, or nothing.

    On a full disk the room of the old one is used, for that would tell of another theta: a note
    that was torn by it is refused when it is read.
    """
    if not path:
        return ""
    try:
        write_json(Path(path), note)
    except LiveError as error:
        try:
            with open(path, "r+b") as file:
                file.write(json.dumps(to_json(note)).encode())
                file.truncate()
                os.fsync(file.fileno())
        except OSError:
            return str(error)
    return ""


def read(path: Path | str | None) -> Note | None:
    """Return the note; None if there is none.

    Raises ConfigError if it is damaged: it may have held a trip.
    """
    if not path or not (values := read_json(Path(path))):
        return None
    try:
        return parse(Note, values, "note")
    except ConfigError as error:
        raise ConfigError(
            f"{path}: is damaged ({error}): look at the rig, then delete it"
        ) from None


def find_theta(
    path: Path | str | None, rig: RigLimits, publishers: Collection[str]
) -> tuple[tuple[float, ...], str]:
    """Return the present value of theta of each knob, and a remark on it, if there is any.

    It is the value at which the last command left it; ``theta_start`` if the rig was started again
    since, or no command has moved it. ``publishers`` are the ids of the rig's now.
    """
    note, remark, begin = read(path), "", rig.each("theta_start")
    if note is not None:
        if note.command != rig.command:
            remark = f"{path} is of {note.command}"
        elif note.publishers and publishers and not set(note.publishers) & set(publishers):
            remark = f"the rig was restarted since theta was left at {format_knobs(note.theta)}"
        elif len(note.theta) != len(begin):
            remark = f"{path} is of {len(note.theta)} knobs"
        else:
            limits = zip(rig.each("theta_min"), note.theta, rig.each("theta_max"), strict=True)
            if all(low <= theta <= high for low, theta, high in limits):
                return note.theta, ""
    return begin, remark and f"{remark}: assuming theta_start = {format_knobs(begin)}"


class Keeper:
    """Writes the note in a thread: a disk may be slow, and theta must not wait for it.

    ``path`` is empty for none; ``current()`` returns what is to be noted now, None for nothing.
    ``failure`` says in words why the last one could not be written, which is tried again.
    """

    def __init__(self, path: str, current: Callable[[], Note | None]) -> None:
        self._path, self._current, self.failure = path, current, ""
        self._news, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def hurry(self) -> None:
        """Write at once, not when it is time."""
        self._news.set()

    def close(self) -> None:
        """Write for the last time."""
        self._over = True
        self._news.set()
        self._thread.join()

    def _run(self) -> None:
        written: Note | None = None
        while True:
            over = self._over
            if (note := self._current()) != written and note is not None:
                self.failure = leave(self._path, note)
                written = written if self.failure else note
            if over:
                return
            self._news.wait(PERIOD)
            self._news.clear()
