"""The models of the study's lifted costs, against independent computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from koop_loop.training import TrainingConfig, train
from koop_study.simulation.case import Case, ScenarioConfig, SensingConfig
from koop_study.simulation.learning import model_of
from vdp_plant.config import PlantConfig

TRAINING = TrainingConfig(trajectories=30, duration=40.0)


@pytest.mark.parametrize("cost", ["lifted", "contrast"])
def test_it_is_the_model_that_koop_train_makes(cost: str) -> None:
    ours = model_of(Case(cost=cost, training=TRAINING))
    assert ours is not None
    theirs = train(PlantConfig(), TRAINING, contrast=cost == "contrast")
    assert ours.projector.tobytes() == theirs.projector.tobytes()
    assert ours.V_dom.tobytes() == theirs.V_dom.tobytes()


def test_contrast_cancels_what_both_states_share() -> None:
    # the paper's interference enters both states alike: only multiples of y - x are free of it
    model = model_of(Case(cost="contrast"))
    assert model is not None
    constant, x, y = model.projector[0, :3]
    assert x / y == pytest.approx(-1.0, abs=0.01)
    # the centre of the oscillation is (x, y) = (6, 0); a drifting limit cycle's mean is near it
    assert constant / y == pytest.approx(6.0, abs=0.4)
    assert not model.projector[0, 3:].any()


def test_contrast_cancels_interference_in_the_proportion_in_which_the_states_have_it() -> None:
    scenario = ScenarioConfig(interference_gain_y=2.0)
    training = replace(TRAINING, degree=1, modes=2)
    model = model_of(Case(cost="contrast", scenario=scenario, training=training))
    assert model is not None
    x, y = model.projector[0, 1:3]
    assert x + 2.0 * y == pytest.approx(0.0, abs=0.01 * np.hypot(x, y))


def test_a_model_of_one_sensor_has_its_delays() -> None:
    sensing = SensingConfig(channels="y", delays=4, spacing=0.1)
    training = replace(TRAINING, degree=1, modes=2)
    model = model_of(Case(cost="contrast", training=training, sensing=sensing))
    assert model is not None
    assert (model.delays.channels, model.delays.count, model.delays.every) == (1, 4, 20)
    assert model.projector.shape[1] == 1 + 4
