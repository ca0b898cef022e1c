"""Quantiles from counts beside NumPy's of the durations themselves."""

import math

import numpy as np
import pytest

from koop_core.stream.durations import Durations, read


def counted(values):
    made = Durations()
    for value in values:
        made.add(value)
    return made


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99, 0.999, 1.0])
def test_a_quantile_is_known_to_one_size(share):
    values = np.random.default_rng(1).lognormal(-8.0, 1.5, 20_000)
    exact = np.quantile(values, share, method="inverted_cdf")
    actual = counted(values.tolist()).quantile(share)
    assert exact <= actual <= exact * 2 ** (1 / 16) * (1 + 1e-12)  # a size is 1/16 octave wide


def test_no_duration_is_lost_however_small_or_large():
    assert counted([0.0, -1.0, 1e-9, 1e-6, 1.0, 1e9, math.nan]).count == 6


def test_of_nothing_no_quantile_is_known():
    assert math.isnan(Durations().quantile(0.5))


def test_counts_add_up_and_tell_what_came_between():
    early, late = counted([1e-3] * 5), counted([1e-3] * 5 + [2e-3] * 3)
    assert (late - early).count == 3
    assert (late - early).quantile(0.0) == pytest.approx(2e-3, rel=0.05)
    assert (early + late).count == 13
    assert (read(late.text()).counts == late.counts).all()
