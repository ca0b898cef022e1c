"""What a replay says of two signals that are not the same."""

import math

import numpy as np

from koop_lab.commands.replay import compare

STEP = np.array([3, 4, 6, 7])


def test_the_first_difference_and_the_largest_are_named():
    recorded, replayed = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.5, 3.0, 1.0])
    assert compare("r", STEP, recorded, replayed) == (
        2,
        "r      differs in 2 of 4 steps, first at step 4: recorded 2.0, replayed 2.5; largest "
        "difference 3 at step 7",
    )


def test_a_bit_is_a_difference_and_so_is_the_sign_of_zero():
    for value, other in ((1.0, np.nextafter(1.0, 2.0)), (0.0, -0.0)):
        replayed = np.array([value, value, other, value])
        different, text = compare("r", STEP, np.full(4, value), replayed)
        assert different == 1
        assert "first at step 6" in text


def test_what_is_not_a_number_equals_only_its_like():
    recorded, replayed = np.array([math.nan, math.nan, 1.0, 2.0]), np.array([-math.nan, 5.0, 1, 9])
    different, text = compare("r", STEP, recorded, replayed)
    assert different == 2
    assert "first at step 4: recorded nan, replayed 5.0; largest difference inf at step 4" in text
    assert compare("r", STEP, recorded, -recorded * [1, 1, -1, -1])[0] == 0


def test_equal_signals_and_none_at_all_are_no_difference():
    assert compare("theta", STEP, np.zeros(4), np.zeros(4)) == (
        0, "theta  identical bit for bit in all 4 steps"
    )  # fmt: skip
    nothing = np.empty(0)
    assert compare("r", STEP[:0], nothing, nothing) == (
        0, "r      nothing recorded to compare with"
    )  # fmt: skip
