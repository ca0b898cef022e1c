"""The amplitude of an oscillation in a window of samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def amplitude(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the amplitude of each window: the amplitude of a sine of the same power.

        A = sqrt(2) sigma,   sigma^2 the mean square about the window's straight line

    The line takes out the operating point and its drift. Noise and interference of the sensor
    count, as they do in the signal. The samples, shape (..., L), are evenly spaced, L at least 3;
    the amplitude, shape (...), is NaN where one is not finite.
    """
    t = np.linspace(-1.0, 1.0, x.shape[-1])
    centred = x - x.mean(axis=-1, keepdims=True)
    slope = (centred @ t) / (t @ t)
    return np.asarray(np.sqrt(2.0 * ((centred - slope[..., None] * t) ** 2).mean(axis=-1)))
