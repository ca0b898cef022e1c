"""Training data of the study: the Gram sums of the paper's method and second moments by trajectory.

The improved costs look at how the trajectories differ from each other, which the pooled Gram sums
cannot tell. Neither theta nor theta* enters: only measured states do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from koop_loop.training import TrainingConfig, trajectories
from koop_study.simulation.scenario import ScenarioConfig, second_channel
from koop_study.simulation.sensing import SensingConfig
from koopman_lifter.contrast import TRANSIENT
from koopman_lifter.edmd import Gram
from koopman_lifter.observables import Monomials
from vdp_plant.config import PlantConfig


@dataclass(frozen=True)
class Learned:
    """What the training data says.

    Attributes
    ----------
    gram : Gram
        Sums over all snapshot pairs, as in ``koop_loop.training``.
    covariances : ndarray, shape (T, p, p)
        Covariance of the observables over the settled part of each of T trajectories.
    means : ndarray, shape (T, p)
        Mean of the observables over the same parts.
    dropped : int
        Trajectories left out because they diverged.
    sensing : SensingConfig
        What the states are.
    """

    gram: Gram
    covariances: NDArray[np.float64]
    means: NDArray[np.float64]
    dropped: int
    sensing: SensingConfig


def learn(
    plant: PlantConfig, scenario: ScenarioConfig, training: TrainingConfig, sensing: SensingConfig
) -> Learned:
    """Simulate the training trajectories and sum them up; what differs in N only is shared."""
    return _learn(plant, scenario, replace(training, modes=1), sensing)


@lru_cache(maxsize=128)
def _learn(
    plant: PlantConfig, scenario: ScenarioConfig, training: TrainingConfig, sensing: SensingConfig
) -> Learned:
    delays = sensing.embedding(plant.dt)
    gram = Gram.empty(Monomials(delays.n, training.degree))
    covariances, means, dropped = [], [], 0
    rng = np.random.default_rng([training.seed, 2])
    added: NDArray[np.float64] | None = None
    for states in trajectories(plant, training):
        if states is None:
            dropped += 1
            continue
        if added is None:
            added = second_channel(
                scenario, plant, np.arange(states.shape[1], dtype=np.float64) * plant.dt
            )
        if added.size and training.corrupted:
            states[1] += added
        sensed = states[sensing.indices]
        if sensing.training_noise > 0.0:
            deviation = sensing.training_noise * sensed.std(axis=1, keepdims=True)
            sensed += deviation * rng.standard_normal(sensed.shape)
        embedded = delays.embed(sensed)
        gram.add_trajectory(embedded)
        lifted = gram.observables.lift(embedded[:, round(TRANSIENT * embedded.shape[1]) :])
        mean = lifted.mean(axis=1)
        lifted -= mean[:, None]
        covariances.append(lifted @ lifted.T / lifted.shape[1])
        means.append(mean)
    if not covariances:
        raise ValueError("every training trajectory diverged")
    return Learned(gram, np.array(covariances), np.array(means), dropped, sensing)
