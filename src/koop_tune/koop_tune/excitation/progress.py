"""How far an excitation is, in a file beside its recordings: what resumes it."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_tune.excitation.features import Bands
from koop_tune.excitation.static_map import StaticMap
from koop_tune.excitation.visits import Visit
from koop_tune.rig.rig_file import RigFile, as_values
from koop_tune.rig.scale import Scale

NAME = "excite.json"
LEVELS = 9  # values of theta
MOST_ERROR = 1e3  # of a logarithm, where too few windows tell none
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass
class ExcitationProgress:
    """What an excitation has done, and what it is going to do.

    Attributes
    ----------
    seed : int
        Seed of the order of theta's values.
    values : list of float
        Values of theta, rising; a visit's level is the number of one.
    bands : Bands or None
        How windows are looked at, once that is known.
    visits : list of Visit
        Done.
    queue : list of int
        Next values of theta.
    elapsed : float
        Time of all parts [s].
    parts : list of str
        Folders of the recordings.
    done : bool
        Whether it has come to its end.
    added_values : int
        How many of the values were added, beside a cliff.
    """

    seed: int
    values: list[float]
    bands: Bands | None
    visits: list[Visit]
    queue: list[int]
    elapsed: float
    parts: list[str]
    done: bool = False
    added_values: int = 0

    @property
    def levels(self) -> int:
        """Number of values that it began with."""
        return len(self.values) - self.added_values

    @property
    def staircase(self) -> int:
        """Number of visits up and down."""
        return 2 * self.levels - 1

    @property
    def reached(self) -> list[int]:
        """Numbers of the values at which theta was, rising."""
        return sorted({visit.level for visit in self.visits})

    def add(self, level: int, value: float) -> None:
        """Add a value of theta below the one of that number."""
        self.values.insert(level, value)
        self.added_values += 1
        self.visits = [
            replace(visit, level=visit.level + (visit.level >= level)) for visit in self.visits
        ]

    def static_map(self, feature: int, sense: float = 1.0) -> StaticMap:
        """Return the map of one feature over the values that were reached."""
        reached = self.reached
        u = Scale(self.values[0], self.values[-1]).u(np.array([self.values[i] for i in reached]))
        visits = [
            (reached.index(visit.level), visit.mean[feature], min(visit.error[feature], MOST_ERROR))
            for visit in self.visits
        ]
        return StaticMap.from_visits(u, visits, sense)

    def clearest(self, features: Sequence[int]) -> int:
        """Return the feature whose map stands out most from its errors."""
        return max(features, key=lambda feature: self.static_map(feature).clarity)

    def map_of(self, features: Sequence[int]) -> tuple[int, StaticMap]:
        """Return the feature with the clearest map, and the map."""
        feature = self.clearest(features)
        return feature, self.static_map(feature)

    @property
    def lacks_visits(self) -> bool:
        """Whether theta was at some value less than twice; the turning point needs one."""
        visits = [visit.level for visit in self.visits]
        counts = [visits.count(level) for level in range(len(self.values))]
        return sum(count < 2 for count in counts) > 1 or 0 in counts


def begin(seed: int, rig: RigFile) -> ExcitationProgress:
    """Return the progress of an excitation that begins: the values up and down, or down and up."""
    up = rig.theta_start <= 0.5 * (rig.theta_min + rig.theta_max)
    return ExcitationProgress(
        seed, rig.scale.divide(LEVELS), None, [], staircase(up, LEVELS), 0.0, []
    )


def staircase(up_first: bool, count: int) -> list[int]:
    """Return the numbers of all values up and down, or down and up.

    >>> staircase(False, 3)
    [2, 1, 0, 1, 2]
    """
    up = list(range(count))
    return [*up, *up[-2::-1]] if up_first else [*up[::-1], *up[1:]]


def save(progress: ExcitationProgress, rig: RigFile, folder: Path) -> None:
    """Write the file; as :func:`write_json`."""
    write_json(folder / NAME, {"rig": as_values(rig), **asdict(progress)})


def write_json(path: Path, values: Any) -> None:
    """Write a JSON file; as :func:`write_text`."""
    write_text(path, json.dumps(values, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file that is whole at any time.

    Raises
    ------
    koop_core.errors.LiveError
        If it cannot be written, as on a full disk; the old one stays.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with open(new, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as error:
        with suppress(OSError):
            new.unlink()
        raise LiveError(describe_failure(path, error)) from None


def describe_failure(path: Path, error: OSError) -> str:
    """Return why a file or a folder cannot be written, and what to do, in words."""
    room = ": make room" if error.errno in FULL else ""
    return f"{path}: {error.strerror or error}{room}"


def load(rig: RigFile, folder: Path) -> ExcitationProgress | None:
    """Return what was done before; None if nothing was.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the file cannot be used, or is of another rig.
    """
    path = folder / NAME
    if not path.exists():
        return None
    recorded_rig, state = read(folder)
    refuse_other_rig(path, recorded_rig, rig)
    return state


def read(folder: Path) -> tuple[RigFile, ExcitationProgress]:
    """Return the rig, and what was done with it.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the file cannot be used.
    """
    path = folder / NAME
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        recorded_rig = RigFile(**values.pop("rig"))
        bands = values.pop("bands")
        visits = [
            Visit(**{**visit, "mean": tuple(visit["mean"]), "error": tuple(visit["error"])})
            for visit in values.pop("visits")
        ]
        bands = Bands(bands[0], tuple(bands[1]), bands[2]) if bands else None
        state = ExcitationProgress(bands=bands, visits=visits, **values)
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}: choose another --out") from None
    return recorded_rig, state


def refuse_other_rig(path: Path, recorded_rig: RigFile, rig: RigFile) -> None:
    """Refuse a rig file that is not that of what was begun.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it says something else that counts.
    """
    for name, value in as_values(recorded_rig).items():
        if value != as_values(rig)[name] and name not in ("time", "theta_start", "pace"):
            raise ConfigError(
                f"{path}: was begun with {name} = {value}, the rig file says "
                f"{as_values(rig)[name]}: choose another --out"
            )


def read_json(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds; nothing if there is none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it cannot be read.
    """
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}: choose another --out") from None
