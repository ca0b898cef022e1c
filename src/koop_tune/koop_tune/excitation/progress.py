"""How far an excitation is, in a file beside its recordings: what resumes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError
from koop_core.whole_file import read_object, write_json
from koop_tune.excitation.amplitude import Amplitude, Windows
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.rig.rig_file import RigFile, as_values

Array = NDArray[np.float64]
NAME = "excite.json"
SAME = 1e-6  # distance of two holds at one place, of the range


class HoldSummary(NamedTuple):
    """A hold: theta of each knob, logarithm of the amplitude, its error, times [s], and why.

    It ``settled`` within the first time, and was ``seconds`` long.
    """

    theta: tuple[float, ...]
    level: float
    error: float
    settled: float
    seconds: float
    why: str = ""


class SectionLine(NamedTuple):
    """A knob, and a theta through which the section of the map over it goes."""

    knob: int
    theta: tuple[float, ...]


@dataclass
class ExcitationProgress:
    """What an excitation has done; its holds are in its recordings.

    Attributes
    ----------
    windows : Windows or None
        How samples are cut; None before anything was heard.
    amplitude : Amplitude or None
        What is summed; None until something reacts.
    holds : list of HoldSummary
        Finished.
    elapsed : float
        Time of all parts [s].
    parts : list of str
        Folders of the recordings.
    since : float
        Time [s] before which holds do not count.
    ended : str
        Why it ended: ``known``, ``flat`` or ``time``; empty before.
    safe : SafeRange or None
        Thetas that keep the constraint; None before they are known, and without one.
    sections : list of SectionLine
        Of each knob that has an effect, once they are known.
    needed : float
        Time that it needs in all at least [s].
    aside : list of HoldSummary
        Finished, and not counted now: too short for the windows, or not come to again since it was
        resumed, with the amplitude of then.
    """

    windows: Windows | None = None
    amplitude: Amplitude | None = None
    holds: list[HoldSummary] = field(default_factory=list)
    elapsed: float = 0.0
    parts: list[str] = field(default_factory=list)
    since: float = 0.0
    ended: str = ""
    safe: SafeRange | None = None
    sections: list[SectionLine] = field(default_factory=list)
    needed: float = 0.0
    aside: list[HoldSummary] = field(default_factory=list)

    @property
    def done(self) -> list[HoldSummary]:
        """All finished holds."""
        return [*self.holds, *self.aside]

    @property
    def longer(self) -> str:
        """What to do where the rig file's time is too short, in words."""
        return (
            f"set time = {round_up(2.0 * self.needed):g} in it (it ends once the map is known, "
            f"after {round_up(self.needed):g} s or more)"
        )

    def describe_end(self, rig: RigFile) -> str:
        """Return in words why it ended before the map was known."""
        if self.elapsed >= rig.time:
            over = f"the {rig.time:g} s of the rig file were over before the static map was known"
            if self.amplitude is None:
                over += ", and nothing reacts to theta so far ('koop check' tells if it gets there)"
            return f"{over}: {self.longer} and run the same command again"
        return (  # as many holds as there may be
            "the static map is not known yet, and more holds would not help: noise hides the "
            "oscillation, or the rig changes while theta is held; measure where it is stronger, or "
            "set narrower limits of theta, and choose another --out"
        )

    def narrow(self, rig: RigFile) -> RigFile:
        """Return the rig file with the limits of theta that keep the constraint."""
        return rig if self.safe is None else self.safe.narrow(rig)

    def set_holds(self, rig: RigFile, holds: list[HoldSummary]) -> None:
        """Set the holds that count; of those known before the others are put aside."""
        known, self.holds, self.aside = self.done, holds, []
        places = [rig.u(hold.theta) for hold in holds]
        for hold in known:
            off = [np.abs(u - rig.u(hold.theta)).max() for u in places]
            if min(off, default=math.inf) < SAME:
                del places[int(np.argmin(off))]
            else:
                self.aside.append(hold)

    def arrays(self, rig: RigFile) -> tuple[Array, Array, Array]:
        """Return the positions of the holds, shape (M, n), their levels and errors, shape (M,).

        A level is the logarithm of the amplitude, or minus it where the amplitude is to be large.
        """
        u = rig.u(np.reshape([hold.theta for hold in self.holds], (-1, rig.count)))
        levels, errors = np.reshape([(h.level, h.error) for h in self.holds], (-1, 2)).T
        return u, rig.sense * levels, errors


def round_up(seconds: float) -> float:
    """Return a time of two digits that is not shorter.

    >>> round_up(1234.0)
    1300.0
    """
    digit = 10.0 ** (math.floor(math.log10(max(seconds, 1.0))) - 1)
    return math.ceil(seconds / digit) * digit


class Excitation(NamedTuple):
    """Content of the file: the rig, and what was done with it."""

    rig: RigFile
    progress: ExcitationProgress


def save(progress: ExcitationProgress, rig: RigFile, folder: Path) -> None:
    """Write the file; as :func:`koop_core.whole_file.write_json`."""
    write_json(folder / NAME, Excitation(rig, progress))


def read(folder: Path) -> Excitation | None:
    """Return the rig, and what was done with it; as :func:`koop_core.whole_file.read_object`."""
    return read_object(folder / NAME, Excitation)


def load(rig: RigFile, folder: Path) -> ExcitationProgress | None:
    """Return what was done before; None if nothing was.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the file cannot be used, or is of another rig.
    """
    if (recorded := read(folder)) is None:
        return None
    refuse_other_rig(folder / NAME, recorded.rig, recorded.progress.narrow(rig))
    return recorded.progress


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
