"""Windows of a recording for the contrast: as long as the data allow, theta at rest in each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from koop_identify.model.merit import settled_windows
from koop_identify.recording.loaded import Loaded, pieces
from koopman_lifter.contrast import FEWEST
from koopman_lifter.delays import Delays, dominant_period

PERIODS = 10.0  # of the oscillation, that a window is long at most
LEAST = 1.5  # periods that a window is long at least
SKIP = 2.0  # periods that the rig needs after a jump of theta
SHARE = 0.3  # of the time until the next jump, at most


def period_of(loaded: Loaded, dt: float) -> float:
    """Return the period of the oscillation that comes and goes [s]; jumps of theta do not count."""
    cut, skip, rest = loaded.begins, 0, usual_rest(loaded.theta, dt)
    if loaded.theta is not None and np.isfinite(rest):
        cut, skip = cut | jumps(loaded.theta), round(SHARE * rest / dt)
    return dominant_period([loaded.x[:, p.start + skip : p.stop] for p in pieces(cut)], dt)


def jumps(theta: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where theta is no longer what it was, by more than a twentieth of its range."""
    known = theta[np.isfinite(theta)]
    if not known.size:
        return np.zeros(theta.size, np.bool_)
    moved = np.abs(np.diff(theta, prepend=theta[:1]))
    # NaN, where theta is not known, compares false
    return np.asarray(moved > 0.05 * np.ptp(known))


def usual_rest(theta: NDArray[np.float64] | None, dt: float) -> float:
    """Return how long theta usually rests [s]; infinite where it does not jump."""
    if theta is None:
        return np.inf
    places = np.flatnonzero(jumps(theta))
    return float(np.median(np.diff(places))) * dt if places.size > 1 else np.inf


def training_windows(
    loaded: Loaded, delays: Delays, dt: float, period: float
) -> tuple[NDArray[np.int64], int]:
    """Cut the training part of a recording into windows.

    Parameters
    ----------
    loaded : Loaded
        The recording.
    delays : Delays
        A window is longer than they span.
    dt : float
        Time between two states [s].
    period : float
        Of the oscillation [s], see :func:`period_of`.

    Returns
    -------
    starts : ndarray of int, shape (T,)
        First state of each window.
    length : int
        States of a window.

    Raises
    ------
    ValueError
        If there are too few windows; the message says why and what to do.
    """
    skip = min(SKIP * period, SHARE * usual_rest(loaded.theta, dt))
    starts, length = settled_windows(loaded.theta, loaded.begins, dt, skip, PERIODS * period)
    starts = starts[~loaded.held_out[starts]] if starts.size else starts
    if starts.size < FEWEST or length * dt < LEAST * period or length <= 2 * delays.depth:
        pieces, states = int(loaded.begins.sum()), loaded.begins.size
        raise ValueError(
            f"the contrast compares windows of strong and weak oscillation: {starts.size} windows "
            f"of {length * dt:.3g} s were found in {states} states ({pieces} pieces without a gap, "
            f"the oscillation's period is about {period:.3g} s), {FEWEST} of more than "
            f"{max(LEAST * period, 2 * delays.depth * dt):.3g} s are needed: record longer, while "
            "theta moves over its range and rests for some periods at each value"
        )
    return starts, length
