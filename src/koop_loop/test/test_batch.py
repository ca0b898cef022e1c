"""Loops in a batch are those of one at a time, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest

from koop_loop.batch import BLOCK, GROUP, simulate_batch
from koop_loop.loop import LoopDiverged, simulate
from koop_loop.training import TrainingConfig, train
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig
from vdp_plant.config import PlantConfig

STEPS = 3 * BLOCK + 17
LOOPS = GROUP + 3  # a whole group and a part of one


@pytest.fixture(scope="module")
def model():
    return train(PlantConfig(), TrainingConfig(trajectories=4, duration=5.0))


def plants(count, **values):
    return [PlantConfig(seed=seed, **values) for seed in range(count)]


@pytest.mark.parametrize("source", ["raw", "lifted"])
@pytest.mark.parametrize(
    "law",
    [
        {},
        {"law": "adaptive", "dwell": 0.5, "tau_f": 0.2, "step_size": 0.01},
        {"dwell": 0.1, "rate_limit": 0.3, "theta_min": 1.0, "theta_max": 2.5},
    ],
    ids=["relay", "adaptive", "limits"],
)
def test_a_batch_is_one_loop_after_the_other_to_the_last_bit(model, source, law):
    given, lifter, esc = plants(LOOPS), LifterConfig(cost=source), EscConfig(**law)
    learned = model if source == "lifted" else None
    batch = simulate_batch(given, lifter, esc, learned, STEPS)
    for i in (0, 7, GROUP - 1, GROUP, LOOPS - 1):
        one = simulate(given[i], lifter, esc, learned, STEPS)
        np.testing.assert_array_equal(batch.r[i], one.r)
        np.testing.assert_array_equal(batch.theta[i], one.theta)
    assert len({row.tobytes() for row in batch.r}) == LOOPS
    assert np.ptp(batch.theta) > 0.1


def test_euler_is_the_same_as_well():
    given = plants(2, integrator="euler")
    batch = simulate_batch(given, LifterConfig(cost="raw"), EscConfig(), None, 200)
    one = simulate(given[1], LifterConfig(cost="raw"), EscConfig(), None, 200)
    np.testing.assert_array_equal(batch.theta[1], one.theta)


def test_plants_of_a_batch_are_of_one_kind():
    other = replace(PlantConfig(), mu=2.0)
    with pytest.raises(ValueError, match="may differ in seed and initial state only"):
        simulate_batch([PlantConfig(), other], LifterConfig(cost="raw"), EscConfig(), None, 10)


def test_a_loop_that_diverges_is_said():
    given = [*plants(2), PlantConfig(initial_state=(1000.0, 1000.0))]
    with pytest.raises(LoopDiverged, match="diverged at t = "):
        simulate_batch(given, LifterConfig(cost="raw"), EscConfig(), None, 100)
