"""Metrics of a rig whose best theta is not known.

The paper's metrics (``koop_loop.metrics``) measure the way to theta*. A rig has none; what counts
is the amplitude before and after, and whether theta has come to rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_loop.metrics import TAIL
from koop_loop.oscillation import amplitude
from koopman_lifter.delays import dominant_period

PERIODS = 5.0  # of the strongest oscillation, that a window is long by default
LEAST, MOST = 0.04, 0.2  # shares of the run within which that length is kept
WIDENED = 0.1  # by which theta's final swing is widened at both ends before it counts as left
SHORTEST = 8  # samples of a window
REST = 0.2  # of the tail, by which theta must have been in its final swing earlier


@dataclass(frozen=True)
class RigMetrics:
    """Oscillation and theta of one run.

    Attributes
    ----------
    window : float
        Length of the windows in which amplitudes are taken [s].
    before_from, before_to : float
        Time that counts as before [s]: until theta first moves, else the first window.
    after_from, after_to : float
        Time that counts as after, and as the end for theta [s]: the last 30 %.
    before, after : tuple of float
        Amplitude of each channel (``koop_loop.oscillation``): the root mean square over the
        windows; where none is whole, over the longest pieces without a gap; NaN where the data
        have none of 8 samples.
    theta_mean, theta_swing : float or None
        Mean and range of theta at the end; None without theta.
    settled_at : float or None
        When theta last came into its final swing, widened by a tenth at both ends [s]; None if it
        had not been there for a fifth of the end's length when the end began, or if it does not go
        over half of that swing in the second half of the end.
    at_limit : float or None
        Share of the time in which theta was at a limit; None if none is known.
    """

    window: float
    before_from: float
    before_to: float
    after_from: float
    after_to: float
    before: tuple[float, ...]
    after: tuple[float, ...]
    theta_mean: float | None
    theta_swing: float | None
    settled_at: float | None
    at_limit: float | None

    @property
    def reduction(self) -> tuple[float, ...]:
        """By which share the amplitude of each channel has fallen; negative where it has risen."""
        return tuple(
            1.0 - after / before if before > 0.0 else float("nan")
            for before, after in zip(self.before, self.after, strict=True)
        )

    def as_dict(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the figures in JSON terms; NaN becomes None."""
        channels = zip(names, self.before, self.after, self.reduction, strict=True)
        return {
            "amplitude": {
                "definition": "sqrt(2) times the standard deviation about a line, in windows",
                "window": self.window,
                "before": {"from": self.before_from, "to": self.before_to},
                "after": {"from": self.after_from, "to": self.after_to},
                "channels": {
                    name: {"before": _number(b), "after": _number(a), "reduction": _number(r)}
                    for name, b, a, r in channels
                },
            },
            "theta": {
                "settled": None if self.theta_mean is None else self.settled_at is not None,
                "settled_at": self.settled_at,
                "mean": self.theta_mean,
                "swing": self.theta_swing,
                "at_limit": self.at_limit,
            },
        }


def rig_metrics(
    t: NDArray[np.float64],
    x: NDArray[np.float64],
    theta: NDArray[np.float64] | None,
    limited: NDArray[np.bool_] | None = None,
    window: float | None = None,
    start: float | None = None,
) -> RigMetrics:
    """Judge a run.

    Parameters
    ----------
    t : ndarray, shape (M,)
        Time of every state [s], increasing; a pause in it ends a window.
    x : ndarray, shape (M, n)
        Measured states.
    theta : ndarray, shape (M,), or None
        Control input; NaN where it is not known.
    limited : ndarray of bool, shape (M,), or None
        Whether theta is at a limit.
    window : float, optional
        Length of a window [s]; default five periods of the strongest oscillation, at least 4 %
        and at most 20 % of the run.
    start : float, optional
        Time before which the run is left out [s].

    Raises
    ------
    koop_core.errors.InputError
        If there is nothing to judge, or a window is longer than half of it.
    """
    if start is not None:
        kept = t >= start
        t, x = t[kept], x[kept]
        theta = None if theta is None else theta[kept]
        limited = None if limited is None else limited[kept]
    if t.size < 16:
        raise InputError(
            f"{t.size} states" + ("" if start is None else f" from {start:g} s on") + " are too few"
        )
    dt = float(np.median(np.diff(t)))
    span = float(t[-1] - t[0]) + dt
    if window is None:
        window = _usual_window(x, dt, span)
    window = max(window, SHORTEST * dt)
    if window > 0.5 * span:
        raise InputError(f"--window {window:g} s: the run has {span:g} s, choose less than half")
    before_to = _first_move(t, theta)
    if before_to is None or before_to - t[0] < window:
        before_to = float(t[0]) + window
    after_from = float(t[-1]) + dt - max(TAIL * span, window)
    before_to = min(before_to, after_from)
    figures: dict[str, float | None] = dict.fromkeys(
        ("theta_mean", "theta_swing", "settled_at", "at_limit")
    )
    if theta is not None and np.isfinite(theta).any():
        finite = np.isfinite(theta)
        figures = _theta_figures(t[finite], theta[finite], after_from)
        if limited is not None:
            figures["at_limit"] = float(limited[finite].mean())
    length = round(window / dt)
    return RigMetrics(
        length * dt,
        float(t[0]),
        before_to,
        after_from,
        float(t[-1]) + dt,
        _amplitudes(t, x, dt, length, float(t[0]), before_to),
        _amplitudes(t, x, dt, length, after_from, float(t[-1]) + dt),
        **figures,
    )


def _usual_window(x: NDArray[np.float64], dt: float, span: float) -> float:
    x = x[:, np.isfinite(x).any(axis=0)]
    usable = x[np.isfinite(x).all(axis=1)]
    try:
        periods = PERIODS * dominant_period([usable.T], dt)
    except ValueError:  # nothing moves
        periods = 0.0
    return min(max(periods, LEAST * span), MOST * span)


def _first_move(t: NDArray[np.float64], theta: NDArray[np.float64] | None) -> float | None:
    """Return when theta first moves, or is first there; None if it never is or does."""
    if theta is None or not np.isfinite(theta).any():
        return None
    first = int(np.flatnonzero(np.isfinite(theta))[0])
    moves = np.flatnonzero(np.diff(theta[first:]) != 0.0)
    return float(t[first + moves[0] + 1]) if moves.size else None


def _amplitudes(
    t: NDArray[np.float64], x: NDArray[np.float64], dt: float, length: int, begin: float, end: float
) -> tuple[float, ...]:
    half = 0.5 * dt
    rows = np.flatnonzero((t > begin - half) & (t < end - half))
    gap = np.diff(t[rows]) > 1.5 * dt
    usable = []
    parts = np.split(rows, np.flatnonzero(gap) + 1)
    length = min(length, max(part.size for part in parts))  # where no piece is that long
    if length < SHORTEST:
        return (float("nan"),) * x.shape[1]
    for part in parts:
        whole = part[: part.size // length * length].reshape(-1, length)
        usable += [x[window].T for window in whole]
    amplitudes = np.array([amplitude(window) for window in usable]).reshape(-1, x.shape[1])
    return tuple(_root_mean_square(column[np.isfinite(column)]) for column in amplitudes.T)


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else float("nan")


def _theta_figures(
    t: NDArray[np.float64], theta: NDArray[np.float64], after_from: float
) -> dict[str, float | None]:
    end = theta[t >= after_from]
    if not end.size:  # theta was lost before the end
        return dict.fromkeys(("theta_mean", "theta_swing", "settled_at", "at_limit"))
    low, high = float(end.min()), float(end.max())
    margin = WIDENED * (high - low) + 1e-9 * max(abs(low), abs(high))
    outside = np.flatnonzero((theta < low - margin) | (theta > high + margin))
    settled = float(t[outside[-1] + 1]) if outside.size else float(t[0])
    latest = after_from - REST * (float(t[-1]) - after_from)
    second = end[end.size // 2 :]
    if np.ptp(second) < 0.5 * (high - low):  # it did not oscillate
        settled = math.inf
    return {
        "theta_mean": float(end.mean()),
        "theta_swing": high - low,
        "settled_at": settled if settled <= latest else None,
        "at_limit": None,
    }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
