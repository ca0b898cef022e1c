"""What a replay says of two signals that are not the same."""

import math

import numpy as np

from koop_lab.replay.compare import compare

STEP = np.array([3, 4, 6, 7])
HERE = np.ones(4, dtype=bool)


def test_the_first_difference_and_the_largest_are_named():
    recorded, replayed = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.5, 3.0, 1.0])
    result = compare("r", STEP, recorded, replayed, HERE)
    assert (result.compared, result.different) == (4, 2)
    assert result.first == (4, 2.0, 2.5)
    assert result.largest == (3.0, 7)


def test_a_bit_is_a_difference_and_so_is_the_sign_of_zero():
    for value, other in ((1.0, np.nextafter(1.0, 2.0)), (0.0, -0.0)):
        result = compare("r", STEP, np.full(4, value), np.array([value, value, other, value]), HERE)
        assert (result.different, result.first[0]) == (1, 6)


def test_what_is_not_a_number_equals_only_its_like():
    recorded, replayed = np.array([math.nan, math.nan, 1.0, 2.0]), np.array([-math.nan, 5.0, 1, 9])
    result = compare("r", STEP, recorded, replayed, HERE)
    assert (result.different, result.first[0]) == (2, 4)
    assert result.largest == (math.inf, 4)
    assert compare("r", STEP, recorded, -recorded * [1, 1, -1, -1], HERE).different == 0


def test_only_what_was_recorded_is_compared():
    present = np.array([True, False, True, True])
    assert str(compare("theta", STEP, np.zeros(4), np.eye(4)[1], present)) == (
        "theta  identical bit for bit in all 3 steps"
    )
    nothing = compare("theta", STEP, np.zeros(4), np.ones(4), np.zeros(4, dtype=bool))
    assert "nothing recorded to compare with" in str(nothing)
