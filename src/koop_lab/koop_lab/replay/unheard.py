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
    recorder. Theta shows which: a controller that heard several costs has moved by more than one
    step when its thetas are there again. Costs after the last theta count as heard, and so do costs
    before the first, unless the controller joined there (:func:`find_join`).

    Parameters
    ----------
    has_r, has_theta : ndarray of bool, shape (M,)
        Whether the answers were recorded.
    theta : ndarray, shape (M,)
        Recorded theta; its logarithm if the controller seeks on that scale.
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


def first_theta(has_r: NDArray[np.bool_], has_theta: NDArray[np.bool_]) -> int | None:
    """Return the row of the first theta; None if no cost lies before it, or there is none."""
    rows = np.flatnonzero(has_theta)
    return int(rows[0]) if rows.size and has_r[: rows[0]].any() else None


def find_join(
    has_r: NDArray[np.bool_],
    has_theta: NDArray[np.bool_],
    holding: NDArray[np.bool_],
    theta: NDArray[np.float64],
    settling: int,
) -> int | None:
    """Return the row of the cost with which the controller joined the run; None if it did not.

    One that joins holds theta for a time before it seeks. One that heard the costs before, of which
    only the recorder has no theta, holds it for a shorter time, if at all.

    Parameters
    ----------
    has_r, has_theta : ndarray of bool, shape (M,)
        Whether the answers were recorded.
    holding : ndarray of bool, shape (M,)
        Whether theta was held.
    theta : ndarray, shape (M,)
        Recorded theta.
    settling : int
        Costs for which a controller that joins holds theta.
    """
    first = first_theta(has_r, has_theta)
    if first is None or not holding[first]:
        return None
    moved = np.flatnonzero(has_theta & (theta != theta[first]))
    end = moved[moved > first][0] if (moved > first).any() else has_r.size
    return first if np.count_nonzero(has_r[first:end]) >= settling else None
