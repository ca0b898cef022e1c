"""Contents of a commissioning's folder, however far it has come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from koop_bag.errors import BagError
from koop_core.config.parameter import ConfigError
from koop_core.errors import InputError
from koop_identify.model.from_bags import load_bags
from koop_identify.recording.loaded import Loaded
from koop_tune.excitation import progress
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.folder import RIG, TUNED
from koop_tune.result import tune_result
from koop_tune.result.tune_result import Points, TuneResult
from koop_tune.rig.rig_file import RigFile
from koop_tune.search.rounds import Round, Verification, load_verification
from koop_tune.tune_folders import list_bags, reading_of


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
    tuned : TuneResult
        Content of ``tune.json``; empty without it.
    verification : Verification
        Content of ``verify.json``.
    """

    folder: Path
    rig: RigFile
    excitation: ExcitationProgress
    tuned: TuneResult
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
            return load_bags(bags, reading_of(bags[0], self.rig, self.excitation.windows))[0]
        except (BagError, InputError) as error:
            return str(error)

    def tuned_for(self, item: Round) -> TuneResult:
        """Return the ``tune.json`` of a round; a later round sets it aside."""
        result = tune_result.read(self.folder / f"{TUNED}-{item.number}")
        return result if result.verdict else self.tuned

    @property
    def rig_file(self) -> str:
        """The rig file, as a command names it."""
        path = self.folder / RIG
        return str(path) if path.exists() else "RIG.YAML"

    @property
    def feature(self) -> str:
        """The amplitude in words; empty before anything reacts."""
        amplitude = self.excitation.amplitude
        if self.tuned.static_map:
            return self.tuned.static_map.feature
        return amplitude.name(self.rig.names) if amplitude else ""

    @property
    def holds_by_knob(self) -> dict[int, Points]:
        """Holds of the tuning over each knob; before it, of the only knob, the excitation's."""
        if self.tuned.static_map:
            return {knob: each.holds for knob, each in self.tuned.maps.items()}
        holds = sorted(self.excitation.holds)
        if not holds or self.excitation.amplitude is None or self.rig.count > 1:
            return {}
        theta, levels, errors, *_ = map(list, zip(*holds, strict=True))
        return {0: Points([each[0] for each in theta], np.exp(levels).tolist(), errors)}


def read_contents(folder: Path) -> Contents:
    """Read a folder.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is not a folder of ``koop excite``, or a file in it cannot be read.
    """
    if (recorded := progress.read(folder)) is None:
        raise ConfigError(f"{folder}: has no {progress.NAME}: name a folder of 'koop excite'")
    tuned = tune_result.read(folder / TUNED)
    return Contents(folder, *recorded, tuned, load_verification(folder))
