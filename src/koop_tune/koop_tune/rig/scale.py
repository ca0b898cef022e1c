"""Theta's range, and positions in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import judged

ROUNDED = 1e-9  # share of the range that is nothing


@dataclass(frozen=True)
class Scale:
    """Position u of theta in its range, 0 to 1; by its logarithm where the limits are far apart."""

    low: float
    high: float
    apart: float = judged(
        20.0, "ratio of the limits from which on positions are on a scale of log theta", low=1.0
    )

    @property
    def logarithmic(self) -> bool:
        """Whether positions are on a scale of log theta."""
        return self.low > 0.0 and self.high / self.low >= self.apart

    @property
    def span(self) -> float:
        """Length of the range; of log theta's where positions are its."""
        return math.log(self.high / self.low) if self.logarithmic else self.high - self.low

    def u(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions."""
        inside = np.clip(theta, self.low, self.high)
        if self.logarithmic:
            return np.asarray(np.log(inside / self.low) / self.span)
        return np.asarray((inside - self.low) / self.span)

    def theta(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return theta at positions."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** np.asarray(u))
        return np.asarray(self.low + np.asarray(u) * self.span)

    def theta_at(self, u: float) -> float:
        """Return theta at one position; 0 where rounding leaves next to nothing of it.

        >>> Scale(-1.0, 2.0).theta_at(1.0 / 3.0 + 1e-16), Scale(1e-10, 1.0).theta_at(0.0)
        (0.0, 1e-10)
        """
        theta = float(self.theta(np.array(u)))
        is_next_to_zero = abs(theta) < ROUNDED * self.high - ROUNDED * self.low
        return 0.0 if is_next_to_zero and self.low <= 0.0 <= self.high else theta

    def step_away(self, theta: float, share: float) -> float:
        """Return the value that is a share of the range from theta, towards the limit further off.

        >>> Scale(0.5, 8.0).step_away(1.0, 0.25), Scale(0.5, 50.0).step_away(1.0, 0.5)
        (2.875, 10.0)
        """
        if self.logarithmic:
            up = self.high / theta >= theta / self.low
            return theta * (self.high / self.low) ** (share if up else -share)
        up = self.high - theta >= theta - self.low
        return theta + share * (self.high - self.low) * (1 if up else -1)
