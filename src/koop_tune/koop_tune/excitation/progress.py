"""How far an excitation is, in a file beside its recordings: what resumes it."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from koop_core.config.parameter import ConfigError
from koop_core.whole_file import write_json
from koop_tune.excitation.amplitude import Amplitude, Windows
from koop_tune.excitation.safe_range import SafeRange
from koop_tune.rig.rig_file import RigFile, as_values

NAME = "excite.json"


class HoldSummary(NamedTuple):
    """A hold: theta, logarithm of the amplitude, its error, time to settle and all [s], and why."""

    theta: float
    level: float
    error: float
    settled: float
    seconds: float
    why: str = ""


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
    """

    windows: Windows | None = None
    amplitude: Amplitude | None = None
    holds: list[HoldSummary] = field(default_factory=list)
    elapsed: float = 0.0
    parts: list[str] = field(default_factory=list)
    since: float = 0.0
    ended: str = ""
    safe: SafeRange | None = None

    def narrow(self, rig: RigFile) -> RigFile:
        """Return the rig file with the limits of theta that keep the constraint."""
        return rig if self.safe is None else self.safe.narrow(rig)


def save(progress: ExcitationProgress, rig: RigFile, folder: Path) -> None:
    """Write the file; as :func:`koop_core.whole_file.write_json`."""
    amplitude = progress.amplitude
    values = {
        name: getattr(progress, name)
        for name in ("windows", "holds", "elapsed", "parts", "since", "ended", "safe")
    }
    amplitudes = None if amplitude is None else amplitude.as_json()
    write_json(folder / NAME, {"rig": as_values(rig), **values, "amplitude": amplitudes})


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
    refuse_other_rig(path, recorded_rig, state.narrow(rig))
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
        amplitude, windows, safe = (values.pop(name) for name in ("amplitude", "windows", "safe"))
        state = ExcitationProgress(
            Windows(*windows) if windows else None,
            Amplitude.from_json(amplitude) if amplitude else None,
            [HoldSummary(*hold) for hold in values.pop("holds")],
            safe=SafeRange(tuple(safe[0]), tuple(safe[1]), *safe[2:]) if safe else None,
            **values,
        )
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
