"""Losses counted by hand."""

from dataclasses import asdict

import numpy as np
import pytest

from koop_bag.bag.losses import LossCounter, StepReport, count_losses

CASES = {
    "nothing": ([], StepReport()),
    "unbroken": ([0, 1, 2, 3], StepReport(4, first=0, last=3)),
    "late start": ([7, 8], StepReport(2, first=7, last=8)),
    "gaps of 1 and 3": ([0, 2, 3, 7], StepReport(4, lost=4, first=0, last=7)),
    "sent again": ([0, 1, 1, 1, 2], StepReport(5, duplicates=2, first=0, last=2)),
    "restart": ([0, 1, 2, 0, 1], StepReport(5, backward=1, first=0, last=1)),
    "one of another sender": (
        [*range(15_340), 4, 15_340, 15_341],
        StepReport(15_343, backward=1, first=0, last=15_341),
    ),
    "one of another sender, sent twice, and a loss": (
        [80, 81, 3, 3, 84],
        StepReport(5, lost=2, duplicates=1, backward=1, first=80, last=84),
    ),
    "two senders": (
        [step for k in range(300) for step in (1000 + k, 5 + k)],
        StepReport(600, backward=300, first=1000, last=304),
    ),
    "a run after another, with losses where that one ended": (
        [*range(500), *range(490), 495, 502],
        StepReport(992, lost=5 + 6, backward=1, first=0, last=502),
    ),
    "a sender whose steps are those of a clock, after others": (
        [3, 4, 224_728_183, 224_728_184, 224_728_187, 5, 6],
        StepReport(7, lost=2, backward=1, jumps=1, first=3, last=6),
    ),
    "out of order": ([1, 2, 4, 3, 5], StepReport(5, lost=1, backward=1, first=1, last=5)),
}


@pytest.mark.parametrize(("steps", "expected"), CASES.values(), ids=CASES)
def test_gaps_repetitions_and_restarts_are_told_apart(steps, expected):
    assert asdict(count_losses(np.array(steps, np.uint64))) == asdict(expected)
    counter = LossCounter()
    for step in steps:
        counter.add(step)
    assert asdict(counter) == asdict(expected)


@pytest.mark.parametrize("size", [1, 2, 3, 150])
@pytest.mark.parametrize(("steps", "expected"), CASES.values(), ids=CASES)
def test_columns_that_come_in_batches_count_as_one(steps, expected, size):
    counter = LossCounter()
    for begin in range(0, len(steps), size):
        counter.add_many(np.array(steps[begin : begin + size], np.uint64))
    assert asdict(counter) == asdict(expected)


def test_steps_that_go_back_do_not_wrap_around():
    # unsigned steps: the plain difference of 0 after 5 would be 2**64 - 5
    assert count_losses(np.array([5, 0], np.uint64)).lost == 0
