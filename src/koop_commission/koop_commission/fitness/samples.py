"""Samples of the measured channels, with their arrival. Pure: arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import LiveError


class Samples(NamedTuple):
    """Samples in the order of their arrival.

    Attributes
    ----------
    arrival : ndarray, shape (M,)
        Time of arrival [s].
    stamp : ndarray, shape (M,)
        Stamp of the message [s]; 0 without one.
    step : ndarray, shape (M,)
        Step of the message; -1 without one.
    x : ndarray, shape (M, n)
        Measured channels; NaN where the message has no such number.
    """

    arrival: NDArray[np.float64]
    stamp: NDArray[np.float64]
    step: NDArray[np.int64]
    x: NDArray[np.float64]

    @property
    def has_steps(self) -> bool:
        """Whether the messages count their steps."""
        return bool((self.step >= 0).all() and self.step[-1] > self.step[0])

    @property
    def has_stamps(self) -> bool:
        """Whether the messages have stamps that advance."""
        return bool((self.stamp > 0.0).all() and self.stamp[-1] > self.stamp[0])


def refuse_dead(names: Sequence[str], x: NDArray[np.float64]) -> None:
    """Refuse samples, shape (M, n), in which a channel does not change.

    Raises
    ------
    koop_core.errors.LiveError
        If there is such a channel.
    """
    for name, column in zip(names, x.T, strict=True):
        usable = column[np.isfinite(column)]
        if not usable.size:
            raise LiveError(f"{name} is no longer a number: dead sensor")
        if np.ptp(usable) == 0.0:
            raise LiveError(f"{name} is {usable[0]:g} and does not change: dead sensor")
