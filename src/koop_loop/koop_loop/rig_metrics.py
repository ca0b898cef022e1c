"""Metrics of a rig whose best theta is not known.

The paper's metrics (``koop_loop.metrics``) measure the way to theta*. A rig has none; what counts
is the amplitude before and after, and whether theta has come to rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_loop.oscillation import amplitude
from koop_loop.settings import METRICS
from koopman_lifter.delays import dominant_period


@dataclass(frozen=True)
class RigMetrics:
    """Oscillation and theta of one run."""

    window: float
    """Length of the windows in which amplitudes are taken [s]."""
    before_from: float
    before_to: float
    """Time that counts as before [s]: until theta first moves, else the first window."""
    after_from: float
    after_to: float
    """Time that counts as after, and as the end for theta [s]: the last 30 %."""
    before: tuple[float, ...]
    after: tuple[float, ...]
    """Amplitude of each channel (``koop_loop.oscillation``): the root mean square over the windows;
    where none is whole, over the longest segments without a gap; NaN where the data have none of 8
    samples."""
    theta_mean: tuple[float, ...] | None
    theta_swing: tuple[float, ...] | None
    """Mean and range of each knob at the end; None without theta."""
    settled_at: float | None
    """When theta last came into its final swing, widened by a tenth at both ends [s]; None if it
    had not been there for a fifth of the end's length when the end began, or if it does not go over
    half of that swing in the second half of the end."""
    at_limit: float | None
    """Share of the time in which theta was at a limit; None if none is known."""

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
                "mean": _each(self.theta_mean),
                "swing": _each(self.theta_swing),
                "at_limit": self.at_limit,
            },
        }


def rig_metrics(
    t: NDArray[np.float64],
    x: NDArray[np.float64],
    theta: NDArray[np.float64] | None,
    limited: NDArray[np.bool_] | None = None,
) -> RigMetrics:
    """Judge a run.

    Time [s], shape (M,), is evenly spaced but for gaps. Of the measured channels, shape (M, n), a
    window with a value that is not finite is left out. Theta, shape (M,) or, of n knobs, (M, n), is
    NaN where it is not known; ``limited``, shape (M,), says where it is at a limit.

    Raises
    ------
    koop_core.errors.InputError
        If there is nothing to judge.
    """
    if t.size < 2 * METRICS.shortest:
        raise InputError(f"{t.size} states are too few")
    dt = float(np.median(np.diff(t)))
    begin, end = float(t[0]), float(t[-1]) + dt
    length = round(max(_window(x, dt, end - begin), METRICS.shortest * dt) / dt)
    window = length * dt
    after_from = end - max(METRICS.tail * (end - begin), window)
    theta = None if theta is None else theta.reshape(t.size, -1)
    has_theta = np.zeros(t.size, np.bool_) if theta is None else np.isfinite(theta).all(axis=1)
    before_to = begin + window
    mean = swing = settled = None
    if theta is not None and has_theta.any():
        first = int(np.argmax(has_theta))
        moves = np.flatnonzero((np.diff(theta[first:], axis=0) != 0.0).any(axis=1))
        if moves.size:
            before_to = max(before_to, float(t[first + moves[0] + 1]))
        final = theta[has_theta & (t >= after_from)]
        if final.size:  # else theta was lost before the end
            mean, swing = (tuple(f(final, axis=0).tolist()) for f in (np.mean, np.ptp))
            times = [_settled_at(t[has_theta], knob, after_from) for knob in theta[has_theta].T]
            settled = None if None in times else max(filter(None, times), default=0.0)
    before_to = min(before_to, after_from)
    return RigMetrics(
        window,
        begin,
        before_to,
        after_from,
        end,
        _amplitudes(t, x, dt, length, begin, before_to),
        _amplitudes(t, x, dt, length, after_from, end),
        mean,
        swing,
        settled,
        None if limited is None or not has_theta.any() else float(limited[has_theta].mean()),
    )


def _window(x: NDArray[np.float64], dt: float, span: float) -> float:
    """Return five periods of the strongest oscillation, at least 4 % and at most 20 % of a run."""
    x = x[:, np.isfinite(x).any(axis=0)]
    try:
        periods = METRICS.periods * dominant_period([x[np.isfinite(x).all(axis=1)].T], dt)
    except InputError:  # nothing moves
        periods = 0.0
    return min(max(periods, METRICS.least * span), METRICS.most * span)


def _amplitudes(
    t: NDArray[np.float64], x: NDArray[np.float64], dt: float, length: int, begin: float, end: float
) -> tuple[float, ...]:
    rows = np.flatnonzero((t > begin - 0.5 * dt) & (t < end - 0.5 * dt))
    parts = np.split(rows, np.flatnonzero(np.diff(t[rows]) > 1.5 * dt) + 1)
    length = min(length, max(part.size for part in parts))  # where no segment is that long
    if length < METRICS.shortest:
        return (float("nan"),) * x.shape[1]
    windows = [part[: part.size // length * length].reshape(-1, length) for part in parts]
    squares = amplitude(x[np.concatenate(windows)].transpose(0, 2, 1)) ** 2
    finite = [column[np.isfinite(column)] for column in squares.T]
    return tuple(float(np.sqrt(c.mean())) if c.size else float("nan") for c in finite)


def _settled_at(
    t: NDArray[np.float64], theta: NDArray[np.float64], after_from: float
) -> float | None:
    """Return when theta last came into its final swing [s]; None if it has not settled."""
    final = theta[t >= after_from]
    low, high = float(final.min()), float(final.max())
    if np.ptp(final[final.size // 2 :]) < 0.5 * (high - low):  # it did not oscillate
        return None
    margin = METRICS.widened * (high - low) + 1e-9 * max(abs(low), abs(high))
    outside = np.flatnonzero((theta < low - margin) | (theta > high + margin))
    settled = float(t[outside[-1] + 1]) if outside.size else float(t[0])
    return settled if settled <= after_from - METRICS.rest * (float(t[-1]) - after_from) else None


def _each(values: tuple[float, ...] | None) -> float | tuple[float, ...] | None:
    """Return the value of one knob, or those of several."""
    return values[0] if values is not None and len(values) == 1 else values


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
