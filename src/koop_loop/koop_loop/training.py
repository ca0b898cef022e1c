"""Training data from simulated trajectories (paper section 3.2; table 1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, parameter
from koop_core.kernels import njit
from koopman_lifter.contrast import Moments, settled_moments, with_contrast
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.observables import Monomials
from vdp_plant import dynamics
from vdp_plant.config import PlantConfig
from vdp_plant.dynamics import PlantParams

STATE_NAMES = ("x", "y")
PLAIN = Delays(len(STATE_NAMES))  # the state as it is measured


@dataclass(frozen=True)
class TrainingConfig(Settings):
    """The paper's training set: trajectories at a random, fixed theta from a random state."""

    trajectories: int = parameter(100, "number of simulated trajectories", low=1, high=100_000)
    duration: float = parameter(100.0, "length of one trajectory", unit="s", low=0.1, high=1e5)
    theta_low: float = parameter(-5.0, "lower end of theta", low=-100.0, high=100.0)
    theta_high: float = parameter(5.0, "upper end of theta", low=-100.0, high=100.0)
    degree: int = parameter(3, "largest degree of the monomials", low=1, high=8)
    modes: int = parameter(8, "number N of modes to keep", low=1, high=4096)
    corrupted: bool = parameter(True, "train on x' (with interference) as the paper does")
    seed: int = parameter(0, "seed of theta and the initial states", low=0, high=2**31 - 1)


@njit()
def trajectory_kernel(
    plant: PlantParams, x: float, y: float, theta: float, states: NDArray[np.float64]
) -> bool:
    """Fill ``states``, shape (2, M), with x'(t_k) at constant theta; False if it diverges.

    The plant's actuator has been at ``theta``, or as near as its bounds allow, before.
    """
    applied = min(max(theta, plant.theta_min), plant.theta_max)
    for k in range(states.shape[1]):
        states[0, k], states[1, k] = dynamics.measure(plant, k, x, y)
        x, y, applied = dynamics.advance(plant, k, x, y, applied, theta)
        if not (np.isfinite(x) and np.isfinite(y)):
            return False
    return True


def trajectories(
    plant: PlantConfig, config: TrainingConfig
) -> Iterator[NDArray[np.float64] | None]:
    """Yield x'(t_k) of each training trajectory, shape (2, M + 1); None if it diverged.

    They share a buffer: the next one overwrites it.
    """
    if not config.corrupted:
        plant = replace(plant, interference_amplitude_1=0.0, interference_amplitude_2=0.0)
    rng = np.random.default_rng(config.seed)
    states = np.empty((2, round(config.duration / plant.dt) + 1))
    p = plant.params()
    for _ in range(config.trajectories):
        theta = rng.uniform(config.theta_low, config.theta_high)
        x, y = rng.uniform(-3.0, 3.0, size=2)
        yield states if trajectory_kernel(p, x, y, theta, states) else None


def simulated_gram(
    plant: PlantConfig,
    config: TrainingConfig,
    delays: Delays = PLAIN,
    contrast: list[Moments] | None = None,
) -> tuple[Gram, int]:
    """Simulate the training trajectories and sum them up; ``contrast`` receives moments of each.

    No pair of the sums spans two trajectories. Those that diverged are left out; their number is
    returned, too.
    """
    gram = Gram.empty(Monomials(delays.n, config.degree))
    dropped = 0
    for states in trajectories(plant, config):
        if states is None:
            dropped += 1
        else:
            gram.add_trajectory(delays.embed(states))
            if contrast is not None:
                contrast.append(settled_moments(states, delays))
    return gram, dropped


def train(
    plant: PlantConfig,
    config: TrainingConfig,
    contrast: bool = False,
    delays: Delays = PLAIN,
) -> KoopmanModel:
    """Train a model on simulated trajectories, for the paper's cost or for ``contrast``.

    Raises
    ------
    koop_core.errors.InputError
        If the surviving trajectories cannot determine the model.
    """
    moments: list[Moments] | None = [] if contrast else None
    gram, dropped = simulated_gram(plant, config, delays, moments)
    provenance: dict[str, Any] = {
        "source": "simulation",
        "integrator": "rk4",
        "dropped": dropped,
        **{name: getattr(config, name) for name in config.__dataclass_fields__},
        **({"variant": "contrast"} if contrast else {}),
    }
    model = build(gram, plant.dt, STATE_NAMES, config.modes, provenance, delays)
    if moments is None:
        return model
    return with_contrast(model, *map(np.concatenate, zip(*moments, strict=True)))
