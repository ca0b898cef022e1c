"""Disturbances beyond the paper's plant: noise, lost samples, a moving optimum.

A moving optimum needs no other plant: the oscillator sees only theta - theta*, so an optimum that
is displaced by s is the same plant fed with theta - s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import parameter, validate
from koop_loop.loop import Exposure
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantParams
from vdp_plant.waves import Waves, drive_of, interference_of

BOTH = np.arange(2)  # states of the plant


@dataclass(frozen=True)
class ScenarioConfig:
    """Disturbances of one run; the defaults are the paper's: none.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If a value has the wrong type or is out of range.
    """

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

    def __post_init__(self) -> None:
        validate(self)


# shared by the runs of a unit and by most units of a study
_drive = lru_cache(maxsize=2)(drive_of)
_interference = lru_cache(maxsize=16)(interference_of)  # the seeds of a unit


def kept_waves(p: PlantParams, steps: int) -> Waves:
    """Return the part of the plant that depends on time alone, cached between runs."""
    without_phases = p._replace(interference_phase_1=0.0, interference_phase_2=0.0)
    return Waves(_drive(without_phases, steps), _interference(p, steps))


def interference(plant: PlantConfig, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return i(t) of the paper for an array of times [s]."""
    return plant.interference_amplitude_1 * np.sin(
        plant.interference_frequency_1 * t + plant.interference_phase_1
    ) + plant.interference_amplitude_2 * np.sin(
        plant.interference_frequency_2 * t + plant.interference_phase_2
    )


def second_channel(
    config: ScenarioConfig, plant: PlantConfig, t: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the second state's interference less the first's, shape (M,)."""
    if config.interference_gain_y == 1.0 and config.interference_lag_y == 0.0:
        return np.empty(0)
    lagged = interference(plant, t - config.interference_lag_y)
    return config.interference_gain_y * lagged - interference(plant, t)


@lru_cache(maxsize=1)
def displacement(config: ScenarioConfig, steps: int, dt: float) -> NDArray[np.float64]:
    """Return the displacement of theta*, shape (M,), the same for all seeds; empty if at rest."""
    if config.optimum_swing == 0.0 and config.optimum_jump == 0.0:
        return np.empty(0)
    t = np.arange(steps, dtype=np.float64) * dt
    swing = config.optimum_swing * np.sin(2.0 * np.pi * t / config.optimum_period)
    jumps = config.optimum_jump * (np.floor(t / config.jump_every) % 2.0)
    return np.asarray(swing + jumps)


def expose(
    config: ScenarioConfig,
    plant: PlantConfig,
    steps: int,
    seed: int,
    schedule: NDArray[np.float64] | None = None,
    channels: NDArray[np.int64] = BOTH,
    timeouts: tuple[float, float] = (0.0, 0.0),
) -> Exposure:
    """Draw the disturbances of one run.

    Parameters
    ----------
    config : ScenarioConfig
        Which disturbances.
    plant : PlantConfig
        Whose interference and step size count.
    steps : int
        Length M of the run.
    seed : int
        Of noise and lost samples.
    schedule : ndarray, shape (M,), optional
        Control input for an open-loop run.
    channels : ndarray of int, shape (n,)
        Components of the measured state that the lifter receives.
    timeouts : tuple of float
        Silence after which the state, and the cost, resume [s].
    """
    rng = np.random.default_rng([seed, 1])
    t = np.arange(steps, dtype=np.float64) * plant.dt
    added: NDArray[np.float64] = np.empty((0, 2))
    second = second_channel(config, plant, t)
    if config.noise > 0.0 or second.size:
        drawn = config.noise > 0.0 or config.lost > 0.0  # which is drawn after it
        added = rng.normal(0.0, config.noise, (steps, 2)) if drawn else np.zeros((steps, 2))
        if second.size:
            added[:, 1] += second
    lost: NDArray[np.bool_] = np.empty(0, dtype=np.bool_)
    if config.lost > 0.0:
        lost = rng.random(steps) < config.lost
        lost[0] = False  # the loop begins with the first state that arrives
    return Exposure(
        added,
        lost,
        displacement(config, steps, plant.dt),
        np.empty(0) if schedule is None else schedule,
        channels,
        *timeouts,
        kept_waves(plant.params(), steps),
    )
