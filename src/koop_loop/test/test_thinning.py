"""Thinning hides no peak."""

import numpy as np
import pytest

from koop_loop.thinning import extremes, thin


def test_every_peak_is_an_extreme_of_its_block():
    values = np.sin(np.arange(1000) * 0.01)
    values[437], values[811] = 9.0, -9.0
    low, high = extremes(values, 7)
    assert low.size == high.size == 142
    assert (high[437 // 7], low[811 // 7]) == (9.0, -9.0)
    for i in (0, 50, 141):
        assert low[i] == min(values[7 * i : 7 * i + 7])
        assert high[i] == max(values[7 * i : 7 * i + 7])


def test_a_block_of_one_is_the_signal_and_what_is_left_over_is_left_out():
    values = np.array([3.0, 1.0, 2.0])
    assert extremes(values, 1)[0].tolist() == extremes(values, 1)[1].tolist() == [3.0, 1.0, 2.0]
    assert extremes(values, 2) == (np.array([1.0]), np.array([3.0]))
    assert extremes(values, 4)[0].size == 0


def test_a_thinned_signal_keeps_its_extremes():
    t = np.arange(100_000.0)
    values = np.sin(t / 1000.0)
    values[54_321] = 7.0
    x, y = thin(t, values, 400)
    assert x.size == y.size <= 2 * 400
    assert (y.max(), y.min()) == (7.0, pytest.approx(-1.0, abs=1e-4))
    assert (np.diff(x) > 0.0).all()
    assert thin(t[:10], values[:10], 400)[1].tolist() == values[:10].tolist()
