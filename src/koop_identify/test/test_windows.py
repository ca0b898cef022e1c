"""Windows in which theta rests, cut from recordings whose rests are known."""

import numpy as np
import pytest

from koop_identify.model.windows import cut_windows, settled_windows

DT = 0.1


def begin(size, *others):
    begins = np.zeros(size, bool)
    begins[[0, *others]] = True
    return begins


def test_windows_begin_after_the_skip_and_hold_no_jump():
    theta = np.repeat([0.0, 4.0, -3.0, 1.0], 300)
    starts, length = settled_windows(theta, begin(1200), DT, 10.0)
    assert (starts.tolist(), length) == ([100, 400, 700, 1000], 190)
    shorter, length = settled_windows(theta, begin(1200), DT, 10.0, longest=9.0)
    assert (shorter.tolist(), length) == ([100, 190, 400, 490, 700, 790, 1000, 1090], 90)


def test_a_gap_ends_a_window_as_a_jump_does():
    theta = np.repeat([0.0, 4.0], 300)
    starts, length = settled_windows(theta, begin(600, 150), DT, 10.0)
    assert starts.tolist() == [400]  # what is left of the others is shorter
    assert length == 190


def test_where_theta_always_moves_it_moves_by_a_tenth_within_a_window():
    theta = 5.0 * np.abs(np.arange(2000) % 400 - 200) / 200  # a triangle from 5 to 0 and back
    starts, length = settled_windows(theta, begin(2000), DT, 1.0)
    assert length == pytest.approx(20, abs=1)
    assert np.ptp(cut_windows(theta, starts, length), axis=1).max() < 0.6


def test_without_theta_the_data_are_cut_into_equal_parts():
    starts, length = settled_windows(None, begin(2100), DT, 10.0)
    assert (starts[0], length, starts.size) == (100, 100, 20)


def test_nothing_settled_means_no_windows():
    assert settled_windows(None, begin(50), DT, 10.0)[0].size == 0
