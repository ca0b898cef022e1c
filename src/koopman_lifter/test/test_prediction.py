"""The error of a forecast, in the units that the table of `koop train` gives it."""

import numpy as np
import pytest

from koopman_lifter.edmd import Gram
from koopman_lifter.model import build
from koopman_lifter.observables import Monomials
from koopman_lifter.prediction import Forecast


def test_an_error_of_1_is_that_of_predicting_the_mean():
    """Independent samples: the best linear forecast is their mean, far from zero here."""
    states = 7.0 + np.random.default_rng(1).normal(size=(2, 40_000))
    gram = Gram.empty(Monomials(2, 1))
    gram.add_trajectory(states)
    forecast = Forecast(build(gram, 0.1, ("a", "b"), 3, {}), (1,))
    forecast.add(states, 0)
    (item,) = forecast.result()
    # of 40 000 samples the standard deviation is known to 0.4 %
    assert item["error"] == pytest.approx([1.0, 1.0], rel=0.01)
    assert item["no_change"] == pytest.approx([np.sqrt(2.0)] * 2, rel=0.01)
