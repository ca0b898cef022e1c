"""One case of the study: every configuration of a closed loop, and how a seed varies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from koop_core.config.parameter import ConfigError, refuse_unknown
from koop_loop.training import TrainingConfig
from koop_study.controllers.adaptive import AdaptiveConfig
from koop_study.controllers.perturbation import PerturbationConfig
from koop_study.simulation.kernel import CONTROLLERS
from koop_study.simulation.learning import learn
from koop_study.simulation.scenario import ScenarioConfig
from koop_study.simulation.sensing import SensingConfig
from koop_study.simulation.variants import COSTS, make
from koopman_lifter.config import LifterConfig
from koopman_lifter.model import KoopmanModel
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig


@dataclass(frozen=True)
class Case:
    """A closed loop: which cost, which controller, and all of their configurations.

    Attributes
    ----------
    cost : str
        ``raw`` or one of the lifted costs of :mod:`koop_study.simulation.variants`.
    controller : str
        ``relay`` (the paper's), ``adaptive`` or ``perturbation``.
    duration : float
        Length of the run [s].
    """

    cost: str = "lifted"
    controller: str = "relay"
    duration: float = 2500.0
    plant: PlantConfig = field(default_factory=PlantConfig)
    lifter: LifterConfig = field(default_factory=LifterConfig)
    esc: EscConfig = field(default_factory=EscConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    scenario: ScenarioConfig = field(default_factory=ScenarioConfig)
    sensing: SensingConfig = field(default_factory=SensingConfig)
    adaptive: AdaptiveConfig = field(default_factory=AdaptiveConfig)
    perturbation: PerturbationConfig = field(default_factory=PerturbationConfig)

    def __post_init__(self) -> None:
        for name, allowed in (("cost", COSTS), ("controller", tuple(CONTROLLERS))):
            if getattr(self, name) not in allowed:
                raise ConfigError(
                    f"{name} = {getattr(self, name)!r}: must be one of {', '.join(allowed)}"
                )
        if not 0.0 < self.duration <= 1e6:
            raise ConfigError(f"duration = {self.duration}: must be above 0 and at most 1e6 s")
        self._refuse(WITHOUT_EFFECT[self.controller], f"controller '{self.controller}'")
        self._refuse(WITHOUT_EFFECT.get(self.cost, {}), f"cost '{self.cost}'")

    def _refuse(self, without_effect: dict[str, tuple[str, ...]], what: str) -> None:
        """Raise ConfigError if a setting that does nothing is not at its default."""
        for part, names in without_effect.items():
            given, default = getattr(self, part), type(getattr(self, part))()
            for name in names or [item.name for item in fields(given)]:
                if getattr(given, name) != getattr(default, name):
                    raise ConfigError(
                        f"{part}.{name} = {getattr(given, name)!r}: has no effect with the {what}"
                    )

    @property
    def steps(self) -> int:
        """Number of control steps."""
        return round(self.duration / self.plant.dt)


# by controller and by cost; empty: all of a part
WITHOUT_EFFECT: dict[str, dict[str, tuple[str, ...]]] = {
    "raw": {"sensing": ("delays", "spacing", "training_noise")},
    "relay": {"adaptive": (), "perturbation": ()},
    "adaptive": {"perturbation": (), "esc": ("objective",)},
    "perturbation": {
        "adaptive": (),
        "esc": ("objective", "step_size", "dwell", "tau_f", "epsilon_initial", "cost_timeout"),
    },
}
NODES_ONLY = {  # settings of the nodes that a study has no use for, and why
    "lifter.cost": "the study's own setting 'cost' takes its place",
    "lifter.input_fields": "a study has no topics",
    "lifter.input_type": "a study has no topics",
    "esc.command_topic": "a study has no topics",
    "esc.command_type": "a study has no topics",
    "esc.command_field": "a study has no topics",
}
DRAWN = (  # what `seeded` draws
    "plant.seed", "plant.interference_phase_1", "plant.interference_phase_2", "training.seed",
)  # fmt: skip
PARTS = {item.name for item in fields(Case)} - {"cost", "controller", "duration"}


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
    return ("cost", "controller", "duration", *parts)


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
    learned = learn(plant, channels, case.training, case.sensing)
    return make(case.cost, learned, plant.dt, case.training.modes)
