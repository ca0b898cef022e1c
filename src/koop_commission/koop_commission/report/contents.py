"""Contents of a commissioning's folder, however far it has come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from koop_bag.errors import BagError
from koop_core import whole_file
from koop_core.config.parameter import ConfigError
from koop_core.errors import InputError
from koop_identify.model.from_bags import load_bags
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation import progress
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.folder import FIGURES, TUNED
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.rounds import Round, Verification, load_verification
from koop_tune.tune_folders import list_bags, reading_of

RIG = "rig.yaml"


class MapPoints(NamedTuple):
    """A static map: what its amplitude is of, theta, amplitude, error of its logarithm."""

    feature: str
    theta: list[float]
    amplitude: list[float]
    error: list[float]


@dataclass(frozen=True)
class Contents:
    """The folder of a commissioning.

    Attributes
    ----------
    folder : Path
        The folder.
    rig : RigFile
        As it was when the excitation began.
    excitation : ExcitationProgress
        How far the excitation has come.
    tuned : dict
        Content of ``tune.json``; empty without it.
    verification : Verification
        Content of ``verify.json``.
    """

    folder: Path
    rig: RigFile
    excitation: ExcitationProgress
    tuned: dict[str, Any]
    verification: Verification

    @property
    def bags(self) -> list[Path]:
        """Recordings of the excitation that exist."""
        bags = [self.folder / part / "bag" for part in self.excitation.parts]
        return [bag for bag in bags if bag.is_dir()]

    @cached_property
    def loaded(self) -> Loaded | str:
        """The excitation's recordings; the reason why they cannot be used."""
        try:
            bags = list_bags(self.folder, self.rig, self.excitation)
            if not bags:
                return "no recording yet"
            return load_bags(bags, reading_of(bags[0], self.rig))[0]
        except (BagError, InputError) as error:
            return str(error)

    def tuned_for(self, item: Round) -> dict[str, Any]:
        """Return the ``tune.json`` of a round; a later round sets it aside."""
        return whole_file.read_json(self.folder / f"{TUNED}-{item.number}" / FIGURES) or self.tuned

    @property
    def rig_file(self) -> str:
        """The rig file, as a command names it."""
        path = self.folder / RIG
        return str(path) if path.exists() else "RIG.YAML"

    @property
    def is_excited(self) -> bool:
        """Whether the map is known, or the time over."""
        return bool(self.excitation.ended)

    @property
    def has_controller(self) -> bool:
        """Whether a controller was tuned."""
        return self.tuned.get("verdict") == "tuned"

    @property
    def is_refused(self) -> bool:
        """Whether tuning found no optimum."""
        return bool(self.tuned) and not self.has_controller

    @property
    def static_map(self) -> MapPoints | None:
        """The static map of the tuning, else of the excitation; None without a dwell point."""
        if "static_map" in self.tuned:
            figures = self.tuned["static_map"]
            rows = zip(*(figures[name] for name in ("theta", "amplitude", "error")), strict=True)
            return MapPoints(self.tuned["feature"], *map(list, zip(*sorted(rows), strict=True)))
        state = self.excitation
        if not state.holds or state.amplitude is None:
            return None
        theta, levels, errors, *_ = map(list, zip(*sorted(state.holds), strict=True))
        amplitudes = np.exp(levels).tolist()
        return MapPoints(state.amplitude.name(self.rig.names), theta, amplitudes, errors)


def read_contents(folder: Path) -> Contents:
    """Read a folder.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is not a folder of ``koop excite``, or a file in it cannot be read.
    """
    if not (folder / progress.NAME).exists():
        raise ConfigError(f"{folder}: has no {progress.NAME}: name a folder of 'koop excite'")
    rig, state = progress.read(folder)
    tuned = whole_file.read_json(folder / TUNED / FIGURES)
    return Contents(folder, rig, state, tuned, load_verification(folder))
