"""The file that notes where theta of a rig was left. Pure."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Protocol

THETA_LEFT = "theta is left at"  # begins the last words of guard and twin


class ThetaRange(Protocol):
    """What of a rig bounds the note."""

    @property
    def theta_min(self) -> float: ...
    @property
    def theta_max(self) -> float: ...
    @property
    def theta_start(self) -> float: ...


def note_of(rig_file: str | Path) -> Path:
    """Return the file that notes the value at which theta of a rig was left."""
    path = Path(rig_file)
    return path.with_name(f".{path.name}.theta")


def leave(note: Path | str | None, theta: float, publishers: Collection[str]) -> None:
    """Note the value at which theta of which rig is left; no note is no fault."""
    if note:
        words = [repr(theta), *sorted(publishers)]
        with suppress(OSError):
            Path(note).write_text(" ".join(words) + "\n")


def find_theta(
    note: Path | str | None, rig: ThetaRange, publishers: Collection[str]
) -> tuple[float, str]:
    """Return the present value of theta, and a remark on it, if there is any.

    It is the value at which the last command left it; ``theta_start`` if the rig was started again
    since, or no command has moved it.

    Parameters
    ----------
    note : Path, str or None
        File of :func:`note_of`.
    rig : ThetaRange
        The rig.
    publishers : collection of str
        Ids of the rig's publishers now.
    """
    if note:
        with suppress(OSError, ValueError):
            value, *ids = Path(note).read_text().split() or [""]
            theta = float(value)
            if ids and publishers and not set(ids) & set(publishers):
                return rig.theta_start, (
                    f"the rig was restarted since theta was left at {theta:g}: assuming "
                    f"theta_start = {rig.theta_start:g}"
                )
            if rig.theta_min <= theta <= rig.theta_max:
                return theta, ""
    return rig.theta_start, ""
