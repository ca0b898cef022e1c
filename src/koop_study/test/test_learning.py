"""The models of the study's lifted costs, against independent computations."""

from __future__ import annotations

import pytest

from koop_loop.training import TrainingConfig, train
from koop_study.simulation.case import Case
from koop_study.simulation.run import model_of
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
