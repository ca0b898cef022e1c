"""Models of the study: the paper's training, also on one sensor and with unequal interference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koop_loop.training import TrainingConfig, trajectories
from koop_study.simulation.scenario import ScenarioConfig, second_channel
from koop_study.simulation.sensing import SensingConfig
from koopman_lifter.contrast import TrajectoryMoments, with_contrast
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.observables import Monomials
from vdp_plant.config import PlantConfig


@dataclass(frozen=True)
class Learned:
    """Sums over the training data.

    Attributes
    ----------
    gram : Gram
        Over all snapshot pairs, as in ``koop_loop.training``.
    moments : TrajectoryMoments
        Of every trajectory, for the contrast.
    """

    gram: Gram
    moments: TrajectoryMoments


def learn(
    plant: PlantConfig, scenario: ScenarioConfig, training: TrainingConfig, sensing: SensingConfig
) -> Learned:
    """Simulate the training trajectories and sum them up; models that differ in N share the sums.

    Raises
    ------
    ValueError
        If every trajectory diverged.
    """
    return _learn(plant, scenario, replace(training, modes=1), sensing)


@lru_cache(maxsize=128)
def _learn(
    plant: PlantConfig, scenario: ScenarioConfig, training: TrainingConfig, sensing: SensingConfig
) -> Learned:
    delays = sensing.embedding(plant.dt)
    gram, moments = Gram.empty(Monomials(delays.n, training.degree)), TrajectoryMoments(delays)
    added: NDArray[np.float64] | None = None
    for states in trajectories(plant, training):
        if states is None:
            continue
        if added is None:
            t = np.arange(states.shape[1], dtype=np.float64) * plant.dt
            added = second_channel(scenario, plant, t)
        if added.size and training.corrupted:
            states[1] += added
        sensed = states[sensing.indices]
        gram.add_trajectory(delays.embed(sensed))
        moments.add(sensed)
    if added is None:
        raise ValueError("every training trajectory diverged")
    return Learned(gram, moments)


def model_for(
    cost: str,
    plant: PlantConfig,
    scenario: ScenarioConfig,
    training: TrainingConfig,
    sensing: SensingConfig,
) -> KoopmanModel:
    """Return the model of the cost ``lifted`` or ``contrast``."""
    learned = learn(plant, scenario, training, sensing)
    embedding, provenance = sensing.embedding(plant.dt), {"variant": cost}
    model = build(learned.gram, plant.dt, sensing.names, training.modes, provenance, embedding)
    return with_contrast(model, *learned.moments.result()) if cost == "contrast" else model
