"""Recorded and replayed answers side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.column_diff import column_diff


def compare(
    name: str,
    step: NDArray[np.int64],
    recorded: NDArray[np.float64],
    replayed: NDArray[np.float64],
) -> tuple[int, str]:
    """Compare a signal bit by bit; two values that are not a number are equal.

    Parameters
    ----------
    name : str
        The signal.
    step : ndarray of int64, shape (M,)
        Steps of the recorded values.
    recorded, replayed : ndarray, shape (M,)
        Values.

    Returns
    -------
    different : int
        How many values differ.
    text : str
        The same in words, with the first difference and the largest.
    """
    if not step.size:
        return 0, f"{name:<6} nothing recorded to compare with"
    difference = column_diff(recorded, replayed, bitwise=True)
    if difference is None:
        return 0, f"{name:<6} identical bit for bit in all {step.size} steps"
    k = difference.first
    return difference.count, (
        f"{name:<6} differs in {difference.count} of {step.size} steps, first at step {step[k]}: "
        f"recorded {float(recorded[k])!r}, replayed {float(replayed[k])!r}; largest difference "
        f"{difference.largest:.6g} at step {step[difference.largest_at]}"
    )
