"""Windows of a recording in which theta is held, or nearly so, and the oscillation's period."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, parameter
from koop_core.errors import InputError
from koop_identify.recording.loaded import Loaded, list_segments
from koopman_lifter.delays import Delays, dominant_period

JUDGED = "set by judgement; the study's contrast models were learned with it"


@dataclass(frozen=True)
class WindowSettings(Settings):
    """How a recording is cut into windows in which theta is held."""

    longest: float = parameter(10.0, "periods in a window for the contrast, at most", low=1.0)
    shortest: float = parameter(
        1.5, "periods in a window for the contrast, at least", low=1.0, origin=JUDGED
    )
    fewest: int = parameter(
        8, "windows for the contrast", low=2, origin="two quarters of two windows, strong and weak"
    )
    skip: float = parameter(
        2.0, "periods that the rig needs after a jump of theta", low=0.0, origin=JUDGED
    )
    skip_share: float = parameter(
        0.3, "of the time until the next jump, skipped at most", low=0.0, high=1.0, origin=JUDGED
    )
    jump: float = parameter(
        0.05, "share of theta's range by which theta moves in a jump", low=0.0, high=1.0,
        origin=JUDGED,
    )  # fmt: skip
    quiet: float = parameter(
        0.1, "share of theta's range by which theta may move within a window", low=0.0, high=1.0,
        origin=JUDGED,
    )  # fmt: skip
    shorter: float = parameter(
        0.95, "length of a window over half of the settled segments' length", low=0.1, high=1.0,
        origin="a segment that is slightly shorter counts, too",
    )  # fmt: skip
    without_theta: int = parameter(20, "windows of a recording without theta", low=2)


DEFAULTS = WindowSettings()


def period_of(loaded: Loaded, dt: float) -> float:
    """Return the period of the oscillation that comes and goes [s]; jumps of theta do not count."""
    cut, skip, rest = loaded.begins, 0, usual_rest(loaded.theta, dt)
    if loaded.theta is not None and np.isfinite(rest):
        cut = cut | jumps(loaded.theta)
        skip = round(DEFAULTS.skip_share * rest / dt)
    return dominant_period([loaded.x[:, p.start + skip : p.stop] for p in list_segments(cut)], dt)


def jumps(theta: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where theta changes by more than the settings' share of its range."""
    finite = theta[np.isfinite(theta)]
    if not finite.size:
        return np.zeros(theta.size, np.bool_)
    moved = np.abs(np.diff(theta, prepend=theta[:1]))
    # NaN, where theta is not known, compares false
    return np.asarray(moved > DEFAULTS.jump * np.ptp(finite))


def usual_rest(theta: NDArray[np.float64] | None, dt: float) -> float:
    """Return how long theta usually rests [s]; infinite where it does not jump."""
    if theta is None:
        return np.inf
    places = np.flatnonzero(jumps(theta))
    return float(np.median(np.diff(places))) * dt if places.size > 1 else np.inf


def settled_windows(
    theta: NDArray[np.float64] | None,
    begins: NDArray[np.bool_],
    dt: float,
    skip: float,
    longest: float = math.inf,
) -> tuple[NDArray[np.int64], int]:
    """Cut a recording into windows of equal length in which theta is held, or nearly so.

    A segment ends where the data or theta jump; what comes within ``skip`` after it is left out.
    The length follows from the data: at most what half of the settled samples have in one segment,
    and at most the time in which theta, where it always moves, moves by a tenth of its range.

    Theta, shape (M,), is NaN where it is not known; ``begins``, shape (M,), says which samples, dt
    [s] apart, follow on none. Rig and detector need ``skip`` [s] after a jump; a window is at most
    ``longest`` [s], for one shorter than the slowest oscillation says little.

    Returns
    -------
    starts : ndarray of int, shape (K,)
        First sample of each window.
    length : int
        Samples of a window; 0 if there is none.
    """
    nothing = np.empty(0, np.int64), 0
    size, cut = begins.size, begins.copy()
    if not size:
        return nothing
    cut[0] = True
    moved, span = np.zeros(size), 0.0
    if theta is not None and np.isfinite(theta).any():
        finite = np.isfinite(theta)
        span = float(np.nanmax(theta) - np.nanmin(theta))
        moved[1:] = np.nan_to_num(np.abs(np.diff(theta)))
        cut[1:] |= finite[1:] != finite[:-1]
        cut |= moved > DEFAULTS.quiet * span
    bounds = np.append(np.flatnonzero(cut), size)
    usable = np.maximum(np.diff(bounds) - round(skip / dt), 0)
    if not usable.any():
        return nothing
    ordered = np.sort(usable)[::-1]
    half = ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())]
    limits = [longest / dt, DEFAULTS.shorter * half]
    speed = float(moved[~cut].mean()) if (~cut).any() else 0.0
    if speed > 0.0:
        limits.append(DEFAULTS.quiet * span / speed)
    if span == 0.0:
        limits.append(ordered.sum() / DEFAULTS.without_theta)
    length = int(min(limits))
    if length < 3:
        return nothing
    starts = np.concatenate(
        [
            end - count + np.arange(count // length) * length
            for end, count in zip(bounds[1:], usable, strict=True)
        ]
    )
    if span > 0.0:
        assert theta is not None
        # NaN, where theta is not known, compares false
        rests = np.ptp(cut_windows(theta, starts, length), axis=1) <= 2.0 * DEFAULTS.quiet * span
        starts = starts[rests]
    return starts, length


def cut_windows(
    values: NDArray[np.float64], starts: NDArray[np.int64], length: int
) -> NDArray[np.float64]:
    """Return the windows of a signal, shape (..., M), as shape (..., K, length)."""
    return np.asarray(values[..., starts[:, None] + np.arange(length)])


def training_windows(
    loaded: Loaded, delays: Delays, dt: float, period: float
) -> tuple[NDArray[np.int64], int]:
    """Cut a recording into windows for the contrast, as long as data allow.

    They are longer than the delays span, and returned as by :func:`settled_windows`; ``dt`` [s] is
    the time between two states, ``period`` [s] the oscillation's, see :func:`period_of`.

    Raises
    ------
    koop_core.errors.InputError
        If there are too few windows; the message says why and what to do.
    """
    theta, begins = loaded.theta, loaded.begins
    skip = min(DEFAULTS.skip * period, DEFAULTS.skip_share * usual_rest(theta, dt))
    starts, length = settled_windows(theta, begins, dt, skip, DEFAULTS.longest * period)
    shortest, fewest = DEFAULTS.shortest * period, DEFAULTS.fewest
    if starts.size < fewest or length * dt < shortest or length <= 2 * delays.depth:
        raise InputError(
            f"the contrast compares windows of strong and weak oscillation: {starts.size} windows "
            f"of {length * dt:.3g} s were found in {begins.size} states ({int(begins.sum())} "
            f"segments without a gap, the oscillation's period is about {period:.3g} s), {fewest} "
            f"of more than {max(shortest, 2 * delays.depth * dt):.3g} s are needed: record longer, "
            "while theta moves over its range and is held for some periods at each value"
        )
    return starts, length
