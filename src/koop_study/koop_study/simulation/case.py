"""One case of the study: every configuration of a closed loop, and how a seed varies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError, refuse_unknown
from koop_loop.training import TrainingConfig
from koop_study.simulation.learning import model_for
from koop_study.simulation.scenario import ScenarioConfig
from koop_study.simulation.sensing import SensingConfig
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

COSTS = ("raw", "lifted", "contrast")


@dataclass(frozen=True)
class Case:
    """A closed loop: which cost, and the configurations of all its parts.

    Attributes
    ----------
    cost : str
        One of :data:`COSTS`.
    duration : float
        Length of the run [s].
    """

    cost: str = "lifted"
    duration: float = 2500.0
    plant: PlantConfig = field(default_factory=PlantConfig)
    lifter: LifterConfig = field(default_factory=LifterConfig)
    esc: EscConfig = field(default_factory=EscConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    scenario: ScenarioConfig = field(default_factory=ScenarioConfig)
    sensing: SensingConfig = field(default_factory=SensingConfig)

    def __post_init__(self) -> None:
        if self.cost not in COSTS:
            raise ConfigError(f"cost = {self.cost!r}: must be one of {', '.join(COSTS)}")
        if not 0.0 < self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration}: must be above 0 and at most 1e6 s")
        if self.cost == "raw" and self.sensing.delays > 1:
            raise ConfigError("sensing.delays: has no effect with the cost 'raw'")

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return round(self.duration / self.plant.dt)


NODES_ONLY = {  # settings of the nodes that a study has no use for, and why
    "lifter.cost": "the study's own setting 'cost' takes its place",
    "lifter.measured": "a study has no topics",
    "esc.command": "a study has no topics",
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


def model_of(case: Case) -> KoopmanModel | None:
    """Return the model that the case's cost needs, trained now or remembered; None for raw.

    The training plant has the paper's phases of the interference: a recording made earlier knows
    nothing of the phase that a run will meet.
    """
    if case.cost == "raw":
        return None
    plant = replace(
        case.plant,
        seed=0,
        initial_state=(),
        theta_initial=PlantConfig.theta_initial,
        interference_phase_1=0.0,
        interference_phase_2=0.0,
    )
    channels = replace(
        ScenarioConfig(),
        interference_gain_y=case.scenario.interference_gain_y,
        interference_lag_y=case.scenario.interference_lag_y,
    )
    return model_for(case.cost, plant, channels, case.training, case.sensing)
