"""The lifted costs beyond the paper's, against independent computations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from koop_loop.training import TrainingConfig
from koop_study.simulation.case import Case, model_of, override
from koop_study.simulation.learning import Learned, learn
from koop_study.simulation.scenario import ScenarioConfig
from koop_study.simulation.sensing import SensingConfig
from koop_study.simulation.variants import CORRELATION_MODES, VARIANTS, amplitudes, make
from koopman_lifter.edmd import edmd
from koopman_lifter.model import load
from koopman_lifter.modes import decompose
from vdp_plant.config import PlantConfig

TRAINING = TrainingConfig(trajectories=30, duration=40.0)


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learn(PlantConfig(), ScenarioConfig(), TRAINING, SensingConfig())


@pytest.fixture
def states() -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-20.0, 20.0, (2, 50))


def test_contrast_cancels_what_both_states_share() -> None:
    # the paper's interference enters both states alike: only multiples of y - x are free of it
    model = model_of(override(Case(), {"cost": "contrast"}))
    assert model is not None
    constant, x, y = model.projector[0, :3]
    assert x / y == pytest.approx(-1.0, abs=0.01)
    # the centre of the oscillation is (x, y) = (6, 0); a drifting limit cycle's mean is near it
    assert constant / y == pytest.approx(6.0, abs=0.4)
    assert not model.projector[0, 3:].any()


def test_contrast_finds_a_constructed_direction(learned: Learned) -> None:
    common, own = np.array([1.0, 2.0]), np.array([1.0, 1.0])
    covariances = np.zeros((8, 10, 10))
    for i in range(8):
        block = 100.0 * np.outer(common, common) + (i + 1.0) * np.outer(own, own) + 0.01 * np.eye(2)
        covariances[i, 1:3, 1:3] = block
    made = Learned(learned.gram, covariances, np.zeros((8, 10)), 0, SensingConfig())
    direction = make("contrast", made, 0.005, 8).projector[0, 1:3]
    # orthogonal to the common part up to the 0.01 of noise against 100
    assert abs(direction @ common) < 1e-2 * np.abs(direction).sum()


def test_amplitude_is_the_mean_square_of_the_centred_states(learned: Learned) -> None:
    assert amplitudes(learned).shape == (TRAINING.trajectories,)
    # interference alone has (10.5^2 + 11.1^2) / 2 on each state
    assert amplitudes(learned).min() > 0.9 * (10.5**2 + 11.1**2)


def test_balanced_is_least_squares_on_scaled_observables(
    learned: Learned, states: NDArray[np.float64]
) -> None:
    model = make("balanced", learned, 0.005, 8)
    scale = learned.gram.scale
    z = learned.gram.observables.lift(states)
    c, *_ = np.linalg.lstsq(model.V_dom / scale[:, None], z / scale[:, None], rcond=None)
    expected = (np.abs(c) ** 2).sum(axis=0)
    assert np.allclose((model.projector @ z).T ** 2 @ np.ones(8), expected, rtol=1e-6)


def test_weighted_is_a_weighted_sum_of_modal_energies(
    learned: Learned, states: NDArray[np.float64]
) -> None:
    model = make("weighted", learned, 0.005, 8)
    koopman = edmd(learned.gram)
    modes = decompose(koopman, learned.gram)
    z = learned.gram.observables.lift(states)
    energies = np.abs(np.linalg.solve(modes.vectors, z)) ** 2  # (p, M), by another route
    y_out = ((model.projector @ z) ** 2).sum(axis=0)
    from scipy.optimize import nnls

    weights, residual = nnls(energies.T / y_out[:, None], np.ones(y_out.size))
    assert residual < 1e-6  # some non-negative weights explain it
    assert weights.max() > 0.0


def test_correlation_keeps_pairs_whole_and_never_the_constant_mode(learned: Learned) -> None:
    model = make("correlation", learned, 0.005, 8)
    kept = model.eigenvalues[model.kept]
    assert model.kept.sum() in (CORRELATION_MODES, CORRELATION_MODES + 1)
    assert np.allclose(np.sort_complex(kept), np.sort_complex(kept.conj()))
    assert not model.kept[np.argmin(np.abs(model.eigenvalues - 1.0))]


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_cost_is_a_model_file_that_the_lifter_reads(
    variant: str, learned: Learned, tmp_path: Path
) -> None:
    model = make(variant, learned, 0.005, 8)
    model.save(tmp_path / "model.npz")
    again = load(tmp_path / "model.npz")
    assert again.projector.tobytes() == model.projector.tobytes()
    assert again.model_id == model.model_id


def test_learning_sums_what_training_sums(learned: Learned) -> None:
    from koop_loop.training import simulated_gram

    gram, dropped = simulated_gram(PlantConfig(), TRAINING)
    assert np.array_equal(gram.xx, learned.gram.xx)
    assert np.array_equal(gram.yx, learned.gram.yx)
    assert dropped == learned.dropped
