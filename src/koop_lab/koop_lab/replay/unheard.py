"""Which costs the controller did not hear: it was inactive, stopped, or they came too late."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unheard_costs(
    has_r: NDArray[np.bool_],
    has_theta: NDArray[np.bool_],
    theta: NDArray[np.float64],
    step_size: float,
) -> NDArray[np.bool_]:
    """Return which costs left no trace in the controller.

    A cost without a recorded theta was either not heard or its theta was lost on the way to the
    recorder. Theta tells: a controller that heard several costs has moved by more than one step
    when its thetas are there again. What lies before the first theta or after the last counts as
    heard.

    Parameters
    ----------
    has_r, has_theta : ndarray of bool, shape (M,)
        Whether the answers were recorded.
    theta : ndarray, shape (M,)
        Recorded theta.
    step_size : float
        Largest change of theta in a step.
    """
    unheard = np.zeros(has_r.size, np.bool_)
    answered = np.flatnonzero(has_r & has_theta)
    for i in np.flatnonzero(np.diff(answered) > 1).tolist():
        before, after = answered[i], answered[i + 1]
        if abs(theta[after] - theta[before]) <= step_size * (1.0 + 1e-6):
            unheard[before + 1 : after] = has_r[before + 1 : after]
    return unheard
