"""Models of the study: the paper's training, also on one sensor and with unequal interference."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koop_loop.training import TrainingConfig, simulated_gram
from koop_study.simulation.case import Case, ScenarioConfig, SensingConfig
from koopman_lifter.contrast import TrajectoryMoments, with_contrast
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel, build
from vdp_plant.config import PlantConfig


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


@lru_cache(maxsize=128)
def learn(
    plant: PlantConfig, scenario: ScenarioConfig, training: TrainingConfig, sensing: SensingConfig
) -> tuple[Gram, TrajectoryMoments]:
    """Sum up the snapshot pairs of the training trajectories, and for the contrast each of them."""
    delays = sensing.embedding(plant.dt)
    moments = TrajectoryMoments(delays)
    t = np.arange(round(training.duration / plant.dt) + 1, dtype=np.float64) * plant.dt
    added = second_channel(scenario, plant, t)

    def sense(states: NDArray[np.float64]) -> NDArray[np.float64]:
        if added.size and training.corrupted:
            states[1] += added
        return np.asarray(states[sensing.indices])

    gram, _ = simulated_gram(plant, training, delays, moments, sense)
    return gram, moments


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
    channels = ScenarioConfig(
        interference_gain_y=case.scenario.interference_gain_y,
        interference_lag_y=case.scenario.interference_lag_y,
    )
    sensing, training = case.sensing, case.training
    # models that differ in N share the sums
    gram, moments = learn(plant, channels, replace(training, modes=1), sensing)
    embedding, provenance = sensing.embedding(plant.dt), {"variant": case.cost}
    model = build(gram, plant.dt, sensing.names, training.modes, provenance, embedding)
    return with_contrast(model, *moments.result()) if case.cost == "contrast" else model
