"""The amplitude against sines of known size."""

import numpy as np
import pytest

from koop_loop.oscillation import amplitude


def test_a_sine_on_a_sloping_line_has_its_own_amplitude():
    t = np.arange(10_000) * 0.001  # 10 s: 20 whole periods
    signal = 3.0 * np.sin(2.0 * np.pi * 2.0 * t + 0.4)
    line = 40.0 - 7.0 * t
    # the best line through whole periods of a sine is not quite flat: 3 / (pi 20) of its size
    assert amplitude(signal + line) == pytest.approx(3.0, rel=0.01)
    assert amplitude(np.stack((line, signal))) == pytest.approx([0.0, 3.0], rel=0.01, abs=1e-9)


def test_independent_signals_add_their_powers():
    t = np.arange(100_000) * 0.001
    both = 3.0 * np.sin(2.0 * np.pi * 2.0 * t) + 4.0 * np.sin(2.0 * np.pi * 5.0 * t)
    assert amplitude(both) == pytest.approx(5.0, rel=1e-3)


def test_a_window_with_a_hole_has_none():
    assert np.isnan(amplitude(np.array([1.0, np.nan, 2.0, 1.0])))
