"""The contrast: where there is none, that is said."""

import numpy as np
import pytest

from koop_core.errors import InputError
from koopman_lifter.contrast import can_split, with_contrast
from koopman_lifter.delays import Delays
from koopman_lifter.edmd import Gram
from koopman_lifter.model import build
from koopman_lifter.observables import Monomials

DT = 0.05


def test_where_each_theta_has_a_window_in_which_nothing_moves_there_is_no_contrast():
    """Failed before: max() of no pair, of a coarse sensor in a rig whose oscillation stops."""
    gram = Gram.empty(Monomials(1, 1))
    gram.add_trajectory(np.sin(DT * np.arange(400.0))[None])
    model = build(gram, DT, ("a",), 1, {}, Delays(1))
    theta = np.repeat([0.0, 0.5, 1.0], 40)
    covariances = np.tile([0.0, 1.0], theta.size // 2).reshape(-1, 1, 1)
    assert can_split(theta)
    with np.errstate(divide="ignore"), pytest.raises(InputError, match="it has no contrast"):
        with_contrast(model, covariances, np.zeros((theta.size, 1)), theta)
