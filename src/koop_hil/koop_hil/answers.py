"""Surplus answers of a recording, and the age of the states that are answered.

Pure: arrays in, figures out. Times are nanoseconds on the clock of the publisher.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
PASS = 1 << 48  # more than the steps of a plant until it is started again


def answered_twice(cost: Columns, theta: Columns) -> int:
    """Return the number of surplus answers: the answers of a second controller.

    A cost that was repeated may be answered again.

    Parameters
    ----------
    cost, theta : mapping
        ``step`` of every message.

    >>> answered_twice({"step": np.array([1, 2, 2])}, {"step": np.array([1, 1, 2, 2])})
    1
    """
    asked, times_asked = np.unique(cost["step"], return_counts=True)
    answered, times_answered = np.unique(theta["step"], return_counts=True)
    _, here, there = np.intersect1d(answered, asked, return_indices=True)
    extra = times_answered[here].astype(int) - times_asked[there].astype(int)
    return int(np.maximum(extra, 0).sum())


def age_acting(state: Columns, ground_truth: Columns) -> float:
    """Return the largest age [s] of a state when the answer to it began to act on the plant.

    Steps that were not recorded are taken to have ended as early as they can have.

    Parameters
    ----------
    state : mapping
        ``step`` and ``publish_time``.
    ground_truth : mapping
        ``step``, ``publish_time`` and ``theta_step``.
    """
    step, answered = ground_truth["step"].astype(np.int64), ground_truth["theta_step"]
    at = ground_truth["publish_time"].astype(np.int64)
    begun = np.flatnonzero((np.diff(answered) != 0) & (answered[1:] >= 0)) + 1
    when = np.where(step[begun] == step[begun - 1] + 1, at[begun], at[begun - 1])
    return _largest_age(state, answered[begun], when)


def age_sent(state: Columns, theta: Columns) -> float:
    """Return the largest age [s] of a state when an answer to it was sent that moved theta.

    Parameters
    ----------
    state : mapping
        ``step`` and ``publish_time``.
    theta : mapping
        ``step``, ``publish_time`` and ``theta``.
    """
    order = np.argsort(theta["publish_time"], kind="stable")
    moved = order[np.flatnonzero(np.diff(theta["theta"][order])) + 1]
    return _largest_age(state, theta["step"][moved], theta["publish_time"][moved].astype(np.int64))


def _largest_age(state: Columns, answered: NDArray[Any], when: NDArray[np.int64]) -> float:
    """Return the largest age of recorded states; 0 if none of them was answered."""
    at = state["publish_time"].astype(np.int64)
    order = np.argsort(at, kind="stable")
    at, step = at[order], state["step"].astype(np.int64)[order]
    begins = np.flatnonzero(np.diff(step, prepend=step[:1] + 1) < 0)  # of every pass of a plant
    number = np.searchsorted(begins, np.arange(step.size), side="right") * PASS + step
    asked = np.searchsorted(at[begins], when, side="right") * PASS + answered.astype(np.int64)
    numbers, first = np.unique(number, return_index=True)
    place = np.minimum(np.searchsorted(numbers, asked), numbers.size - 1)
    ages = (when - at[first[place]])[numbers[place] == asked]
    return float(np.max(ages, initial=0)) * 1e-9
