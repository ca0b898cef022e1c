"""One case of the study: every configuration of a closed loop, and how a seed varies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import ConfigError, Settings, parameter, refuse_unknown
from koop_loop.training import STATE_NAMES, TrainingConfig
from koopman_lifter.config import LifterConfig
from koopman_lifter.delays import Delays
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

COSTS = ("raw", "lifted", "contrast")
CHANNELS = {"both": (0, 1), "x": (0,), "y": (1,)}


@dataclass(frozen=True)
class ScenarioConfig(Settings):
    """Disturbances of one run; the defaults are the paper's: none."""

    noise: float = parameter(
        0.0, "standard deviation of white noise on each measured state", low=0.0, high=1e3
    )
    lost: float = parameter(0.0, "share of measured states that never arrive", low=0.0, high=0.99)
    optimum_swing: float = parameter(
        0.0, "amplitude of a sinusoidal motion of theta*", low=0.0, high=10.0
    )
    optimum_period: float = parameter(1000.0, "period of that motion", unit="s", low=1.0, high=1e6)
    optimum_jump: float = parameter(0.0, "theta* jumps by this much and back", low=-10.0, high=10.0)
    jump_every: float = parameter(
        800.0, "time between two jumps of theta*", unit="s", low=1.0, high=1e6
    )
    interference_gain_y: float = parameter(
        1.0, "interference on the second state relative to the first", low=-10.0, high=10.0
    )
    interference_lag_y: float = parameter(
        0.0, "delay of the interference on the second state", unit="s", low=0.0, high=100.0
    )


@dataclass(frozen=True)
class SensingConfig(Settings):
    """Measured states and delays; the defaults are the paper's: both states, no delays."""

    channels: str = parameter("both", "measured states", choices=tuple(CHANNELS))
    delays: int = parameter(1, "samples of each of them that make up the state", low=1, high=64)
    spacing: float = parameter(
        0.0, "time between two of these samples", unit="s", low=0.0, high=100.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.delays > 1) != (self.spacing > 0.0):
            raise ConfigError("delays and spacing: both or none; one sample has no spacing")

    @property
    def indices(self) -> NDArray[np.int64]:
        """Positions of the measured channels in the plant's state."""
        return np.array(CHANNELS[self.channels], dtype=np.int64)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        return tuple(STATE_NAMES[i] for i in CHANNELS[self.channels])

    def embedding(self, dt: float) -> Delays:
        """Return the delays at a sampling time [s]."""
        return Delays.spaced(len(CHANNELS[self.channels]), self.delays, self.spacing, dt)


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


def case_of(settings: dict[str, Any], seed: int | None) -> Case:
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
