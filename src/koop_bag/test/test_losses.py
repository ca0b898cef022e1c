"""Losses counted by hand."""

import numpy as np
import pytest

from koop_bag.bag.losses import StepCounter, StepReport, count_losses

CASES = {
    "nothing": ([], StepReport()),
    "unbroken": ([0, 1, 2, 3], StepReport(4, first=0, last=3)),
    "late start": ([7, 8], StepReport(2, first=7, last=8)),
    "gaps of 1 and 3": ([0, 2, 3, 7], StepReport(4, lost=4, first=0, last=7)),
    "sent again": ([0, 1, 1, 1, 2], StepReport(5, duplicates=2, first=0, last=2)),
    "restart": ([0, 1, 2, 0, 1], StepReport(5, backward=1, first=0, last=1)),
}


@pytest.mark.parametrize(("steps", "expected"), CASES.values(), ids=CASES)
def test_gaps_repetitions_and_restarts_are_told_apart(steps, expected):
    assert count_losses(np.array(steps, np.uint64)) == expected
    counter = StepCounter()
    for step in steps:
        counter.add(step)
    assert counter.report() == expected


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize(("steps", "expected"), CASES.values(), ids=CASES)
def test_columns_that_come_in_batches_count_as_one(steps, expected, size):
    counter = StepCounter()
    for begin in range(0, len(steps), size):
        counter.add_many(np.array(steps[begin : begin + size], np.uint64))
    assert counter.report() == expected


def test_steps_that_go_back_do_not_wrap_around():
    # unsigned steps: the plain difference of 0 after 5 would be 2**64 - 5
    assert count_losses(np.array([5, 0], np.uint64)).lost == 0
