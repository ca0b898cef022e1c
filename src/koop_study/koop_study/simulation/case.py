"""One case of the study: every configuration of a closed loop, and how a seed varies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError, refuse_unknown
from koop_loop.training import TrainingConfig
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

COSTS = ("raw", "lifted", "contrast")


@dataclass(frozen=True)
class Case:
    """A closed loop: which cost, and the configurations of all its parts."""

    cost: str = "lifted"
    """One of :data:`COSTS`."""
    duration: float = 2500.0
    """Length of the run [s]."""
    plant: PlantConfig = field(default_factory=PlantConfig)
    lifter: LifterConfig = field(default_factory=LifterConfig)
    esc: EscConfig = field(default_factory=EscConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)

    def __post_init__(self) -> None:
        if self.cost not in COSTS:
            raise ConfigError(f"cost = {self.cost!r}: must be one of {', '.join(COSTS)}")
        if not (isinstance(self.duration, int | float) and 0.0 < self.duration <= 1e6):
            raise ConfigError(f"duration = {self.duration!r}: must be above 0 and at most 1e6 s")

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return round(self.duration / self.plant.dt)


NODES_ONLY = {  # settings of the nodes that a study has no use for, and why
    "lifter.cost": "the study's own setting 'cost' takes its place",
    "lifter.measured": "a study has no topics",
}
DRAWN = (  # what `seeded` draws
    "plant.seed", "plant.interference_phase_1", "plant.interference_phase_2", "training.seed",
)  # fmt: skip
PARTS = {item.name for item in fields(Case)} - {"cost", "duration"}


def override(case: Case, settings: Mapping[str, Any]) -> Case:
    """Return ``case`` with settings such as ``{"esc.dwell": 5.0, "cost": "raw"}``.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a name is unknown (the nearest known one is named) or a value is refused.
    """
    changes: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {}
    for path, value in settings.items():
        check_path(path)
        part, _, name = path.partition(".")
        if name:
            parts.setdefault(part, {})[name] = value
        else:
            changes[part] = value
    for part, values in parts.items():
        try:
            changes[part] = replace(getattr(case, part), **values)
        except ConfigError as error:
            raise ConfigError(f"{part}.{error}") from None
    return replace(case, **changes)


def check_path(path: str) -> None:
    """Raise ConfigError unless ``path`` names a setting of a :class:`Case` that has an effect."""
    if path in NODES_ONLY:
        raise ConfigError(f"{path}: {NODES_ONLY[path]}")
    refuse_unknown([path], known_paths(), "setting")


@lru_cache(maxsize=1)
def known_paths() -> tuple[str, ...]:
    """Every setting by name: ``cost``, ``plant.mu``, ``esc.dwell`` and so on."""
    case = Case()
    parts = [f"{part}.{f.name}" for part in sorted(PARTS) for f in fields(getattr(case, part))]
    return ("cost", "duration", *parts)


def seeded(case: Case, seed: int) -> Case:
    """Return ``case`` with everything that chance decides drawn from ``seed``.

    That is the initial state, the trajectories that the model is trained on and the phases of the
    interference. Seeds pair: every cost and every setting sees the same draws for the same seed.
    """
    phases = np.random.default_rng([seed, 0]).uniform(0.0, 2.0 * np.pi, 2)
    plant = replace(
        case.plant,
        seed=seed,
        interference_phase_1=float(phases[0]),
        interference_phase_2=float(phases[1]),
    )
    return replace(case, plant=plant, training=replace(case.training, seed=seed))


def case_of(settings: dict[str, Any], seed: int | None = None) -> Case:
    """Return the case of some settings; without a seed, everything is as in the paper.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a setting is unknown or would have no effect, or the parts do not fit together.
    """
    case = override(Case(), settings)
    if seed is None:
        return case
    for name in DRAWN:
        if name in settings:
            raise ConfigError(f"{name}: is drawn from the seeds of the experiment")
    return seeded(case, seed)
