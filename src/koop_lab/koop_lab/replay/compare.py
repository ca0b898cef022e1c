"""Recorded and replayed answers side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.column_diff import column_diff


@dataclass(frozen=True)
class Comparison:
    """One signal, replayed and recorded.

    Attributes
    ----------
    name : str
        The signal.
    compared : int
        Number of recorded values.
    different : int
        How many of them differ in any bit; two that are not a number are equal.
    first : tuple of (int, float, float) or None
        Step, recorded and replayed value where they first differ.
    largest : tuple of (float, int) or None
        Largest difference and its step; infinite where only one is a finite number.
    """

    name: str
    compared: int
    different: int
    first: tuple[int, float, float] | None = None
    largest: tuple[float, int] | None = None

    def __str__(self) -> str:
        if not self.compared:
            return f"{self.name:<6} nothing recorded to compare with"
        if self.first is None or self.largest is None:
            return f"{self.name:<6} identical bit for bit in all {self.compared} steps"
        step, recorded, replayed = self.first
        difference, where = self.largest
        return (
            f"{self.name:<6} differs in {self.different} of {self.compared} steps, "
            f"first at step {step}: recorded {recorded!r}, replayed {replayed!r}; "
            f"largest difference {difference:.6g} at step {where}"
        )


def compare(
    name: str,
    step: NDArray[np.int64],
    recorded: NDArray[np.float64],
    replayed: NDArray[np.float64],
    present: NDArray[np.bool_],
) -> Comparison:
    """Compare a signal bit by bit.

    Parameters
    ----------
    name : str
        The signal.
    step : ndarray of int, shape (M,)
        Steps.
    recorded, replayed : ndarray, shape (M,)
        Values.
    present : ndarray of bool, shape (M,)
        Which values were recorded.
    """
    step, recorded, replayed = step[present], recorded[present], replayed[present]
    difference = column_diff(recorded, replayed, bitwise=True)
    if difference is None:
        return Comparison(name, step.size, 0)
    return Comparison(
        name,
        step.size,
        difference.count,
        (
            int(step[difference.first]),
            float(recorded[difference.first]),
            float(replayed[difference.first]),
        ),
        (difference.largest, int(step[difference.largest_at])),
    )
