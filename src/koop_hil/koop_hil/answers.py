"""The age of states when their answers act, from a recording.

Pure: arrays in, figures out. Times are nanoseconds on the clock of the publisher.
"""

from __future__ import annotations

import numpy as np

from koop_bag.bag.columns import Columns

PASS = 1 << 48  # more than the steps of a plant until it is started again


def age_acting(state: Columns, ground_truth: Columns) -> float:
    """Return the largest age [s] of a state when the answer to it began to act on the plant.

    It is 0 if no recorded state was answered. Steps that were not recorded are taken to have ended
    as early as they can have. Columns are ``step`` and ``publish_time``, of the truth also
    ``theta_step``.
    """
    step, answered = (ground_truth[name].astype(np.int64) for name in ("step", "theta_step"))
    at = ground_truth["publish_time"].astype(np.int64)
    begun = np.flatnonzero((np.diff(answered) != 0) & (answered[1:] >= 0)) + 1
    when = np.where(step[begun] == step[begun - 1] + 1, at[begun], at[begun - 1])

    at = state["publish_time"].astype(np.int64)
    order = np.argsort(at, kind="stable")
    at, step = at[order], state["step"].astype(np.int64)[order]
    begins = np.flatnonzero(np.diff(step, prepend=step[:1] + 1) < 0)  # of every pass of a plant
    number = np.searchsorted(begins, np.arange(step.size), side="right") * PASS + step
    asked = np.searchsorted(at[begins], when, side="right") * PASS + answered[begun]
    numbers, first = np.unique(number, return_index=True)
    place = np.minimum(np.searchsorted(numbers, asked), numbers.size - 1)
    ages = (when - at[first[place]])[numbers[place] == asked]
    return float(np.max(ages, initial=0)) * 1e-9
