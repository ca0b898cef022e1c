"""What lies in the folder of a commissioning, and what of it is missing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from koop_bag.errors import BagError
from koop_core.config.parameter import ConfigError
from koop_identify.model.from_bags import load_bags
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation import progress
from koop_tune.excitation.features import Bands
from koop_tune.excitation.progress import Progress
from koop_tune.folder import FIGURES, TUNED
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig.scale import Scale
from koop_tune.tune_folders import reading_of

VERIFIED, RIG = "verify.json", "rig.yaml"


@dataclass(frozen=True)
class Gathered:
    """All that there is.

    Attributes
    ----------
    folder : Path
        Where.
    rig : RigFile
        As it was when the excitation began.
    excited : Progress
        The excitation.
    loaded : Loaded or None
        Its recordings; None if they cannot be used.
    problem : str
        Why not.
    tuned, verified : dict
        ``tune.json`` and ``verify.json``; empty if they are not there.
    """

    folder: Path
    rig: RigFile
    excited: Progress
    loaded: Loaded | None
    problem: str
    tuned: dict[str, Any]
    verified: dict[str, Any]

    @property
    def scale(self) -> Scale:
        """Of theta."""
        return Scale(self.rig.theta_min, self.rig.theta_max)

    @property
    def bags(self) -> list[Path]:
        """The excitation's recordings that are there."""
        return _bags(self.folder, self.excited)

    @property
    def windows(self) -> Bands | None:
        """How the oscillation is looked at."""
        if not self.tuned:
            return self.excited.how
        own = self.tuned["windows"]
        return Bands(own["length"], tuple(own["edges"]), own["dt"])

    def tuned_for(self, number: int) -> dict[str, Any]:
        """Return the tuning that a round of the verification tried; later ones set it aside."""
        return _read(self.folder / f"{TUNED}-{number}" / FIGURES) or self.tuned

    @property
    def file(self) -> str:
        """The rig file, as a command names it."""
        own = self.folder / RIG
        return str(own) if own.exists() else "RIG.YAML"

    @property
    def excitation_over(self) -> bool:
        """Whether the map is known, or the time over."""
        return self.excited.done or self.excited.elapsed >= self.rig.time

    @property
    def found(self) -> bool:
        """Whether a controller was tuned."""
        return self.tuned.get("verdict") == "tuned"

    @property
    def refused(self) -> bool:
        """Whether there was nothing to tune for."""
        return bool(self.tuned) and not self.found

    @property
    def rounds(self) -> list[dict[str, Any]]:
        """Of the verification."""
        return list(self.verified.get("rounds", []))


def gather(folder: Path) -> Gathered:
    """Read a folder.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is not one of ``koop excite``, or a file in it cannot be read.
    """
    if not (folder / progress.NAME).exists():
        raise ConfigError(f"{folder}: holds no {progress.NAME}: name a folder of koop excite")
    rig, excited = progress.read(folder)
    loaded, problem = _load(rig, _bags(folder, excited))
    tuned, verified = (_read(folder / name) for name in (f"{TUNED}/{FIGURES}", VERIFIED))
    return Gathered(folder, rig, excited, loaded, problem, tuned, verified)


def _bags(folder: Path, excited: Progress) -> list[Path]:
    every = [folder / part / "bag" for part in excited.parts]
    return [bag for bag in every if bag.is_dir()]


def _load(rig: RigFile, bags: Sequence[Path]) -> tuple[Loaded | None, str]:
    if not bags:
        return None, "nothing is recorded"
    try:
        return load_bags(bags, reading_of(bags[0], rig))[0], ""
    except (BagError, ValueError) as error:
        return None, str(error)


def _read(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    if not isinstance(found, dict):
        raise ConfigError(f"{path}: holds no object")
    return found
