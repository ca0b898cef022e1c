"""Thinning of a long signal for a drawing, so that no peak is hidden."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def extremes(
    values: NDArray[np.float64], block: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return least and largest of every ``block`` samples; an incomplete last block is ignored.

    NaN, as the cost of an unusable state, is ignored, too. Of values of shape (M,), both have shape
    (M // block,).
    """
    blocks = values[: values.size // block * block].reshape(-1, block)
    return np.fmin.reduce(blocks, axis=1), np.fmax.reduce(blocks, axis=1)


def thin(
    t: NDArray[np.float64], values: NDArray[np.float64], points: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a signal as least and largest value of about so many blocks, one after the other."""
    block = -(-t.size // points)
    if block == 1:
        return t, values
    low, high = extremes(values, block)
    times = [t[start::block][: low.size] for start in (0, block // 2)]
    return np.stack(times, axis=1).ravel(), np.stack([low, high], axis=1).ravel()
