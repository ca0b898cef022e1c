"""How long something took, thousands of times a second: counted by size. Pure: no ROS."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FINE = 16  # sizes that an octave is divided into: each 4.4 % above the one before
SMALLEST = 1e-6  # [s]
SIZES = FINE * 30  # up to 18 minutes


def add(counts: NDArray[np.int64], duration: float) -> None:
    """Count a duration [s], shape (SIZES,); plain Python, and compiled into stages."""
    if duration > SMALLEST:
        size = int(FINE * math.log2(duration / SMALLEST)) + 1
        counts[min(size, SIZES - 1)] += 1
    elif duration == duration:  # not NaN
        counts[0] += 1


class Durations:
    """Counts by size; a quantile is known to 5 %."""

    def __init__(self, counts: NDArray[np.int64] | None = None) -> None:
        self.counts = np.zeros(SIZES, np.int64) if counts is None else counts

    def add(self, duration: float) -> None:
        """Count a duration [s]."""
        add(self.counts, duration)

    @property
    def count(self) -> int:
        """How many were counted."""
        return int(self.counts.sum())

    def quantile(self, share: float) -> float:
        """Return the duration [s] that a share of all do not exceed; NaN if there are none."""
        wanted, passed = share * self.count, 0
        for size, count in enumerate(self.counts):
            passed += count
            if count and passed >= wanted:
                return SMALLEST * 2.0 ** (size / FINE)
        return math.nan

    def __sub__(self, before: Durations) -> Durations:
        """Return the durations that were counted since ``before``, an earlier copy of this."""
        return Durations(self.counts - before.counts)

    def __add__(self, other: Durations) -> Durations:
        return Durations(self.counts + other.counts)

    def text(self) -> str:
        """Return all counts as text, for :func:`read`."""
        return " ".join(f"{size}:{count}" for size, count in enumerate(self.counts) if count)


def read(text: str) -> Durations:
    """Return the durations that :meth:`Durations.text` wrote.

    >>> read("0:3 16:1").quantile(1.0)
    2e-06
    """
    made = Durations()
    for pair in text.split():
        size, _, count = pair.partition(":")
        made.counts[int(size)] = int(count)
    return made
