"""A loop's seconds, gathered into rows of longer intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import Columns
from koop_bag.bag.summary import LoopSecond
from koop_core.config.knobs import MOST

Floats = NDArray[np.float64]
COLUMNS = (
    "header.stamp", "count", "x_min", "x_max", "x_mean", "x_std",
    "r_min", "r_max", "r_mean", "margin_min", "margin_max", "margin_mean",
    *(f"theta_{kind}[{k}]" for kind in ("min", "max", "mean") for k in range(MOST)), "model_id",
)  # fmt: skip
"""Fields of a LoopSummary that are read."""
TABLES = ("x", "r", "margin", "theta")


@dataclass(frozen=True)
class Rows:
    """Intervals of a loop, in order."""

    time: Floats
    """Shape (m,): begin [s since the epoch]."""
    weight: Floats
    """Shape (m,): seconds that it has."""
    power: Floats
    """Shape (m, n): variance of each channel within it."""
    x: Floats
    r: Floats
    margin: Floats
    theta: Floats
    """Shape (m, 3, n or 1): least, largest and mean value; theta, as it is read, of as many knobs
    as there may be."""

    def since(self, time: float) -> Rows:
        """Return those that begin at a time [s since the epoch] or later."""
        later = self.time >= time
        return Rows(*(getattr(self, item.name)[later] for item in fields(self)))

    @property
    def amplitude(self) -> Floats:
        """Amplitude of each channel, shape (m, n)."""
        return np.sqrt(2.0 * self.power)


def from_columns(columns: Columns) -> Rows:
    """Return the rows of LoopSummary messages: one a second."""

    def table(name: str) -> Floats:
        knobs = [f"[{k}]" for k in range(MOST)] if name == "theta" else [""]
        parts = [[columns[f"{name}_{kind}{k}"] for k in knobs] for kind in ("min", "max", "mean")]
        stacked = np.moveaxis(np.array(parts, np.float64), 2, 0)
        return stacked.reshape(len(stacked), 3, -1)

    time = columns["header.stamp"] * 1e-9
    power = columns["x_std"].astype(np.float64) ** 2
    return Rows(time, np.ones(time.size), power, *map(table, TABLES))


def from_seconds(seconds: Sequence[LoopSecond]) -> Rows:
    """Return the rows of seconds that were made of a recording's messages."""

    def table(name: str) -> Floats:
        most = MOST if name == "theta" else 1
        rows = [
            (s.statistics[name][:3] if name in s.statistics else (np.full(most, np.nan),) * 3)
            for s in seconds
        ]
        return np.array([[_filled(part, most) for part in row] for row in rows])

    time = np.array([s.begin * 1e-9 for s in seconds])
    power = np.array([s.statistics["x"].std ** 2 for s in seconds])
    return Rows(time, np.ones(time.size), power, *map(table, TABLES))


def _filled(values: Floats, least: int) -> Floats:
    """Return values, shape (..., n), with NaN behind them up to a least n."""
    lacking = [(0, 0)] * (values.ndim - 1) + [(0, max(least - values.shape[-1], 0))]
    return np.pad(values, lacking, constant_values=np.nan)


def with_guard(rows: Rows, time: Floats, theta: Floats, tripped: NDArray[np.bool_]) -> Rows:
    """Return rows whose theta is the guard's where it had tripped.

    Parameters
    ----------
    time, tripped : ndarray, shape (k,)
        What the guard said [s since the epoch], at least once.
    theta : ndarray, shape (k, n)
        The same of theta, which moves evenly in between.
    """
    last = np.searchsorted(time, rows.time, "right") - 1
    held = (last >= 0) & tripped[last]
    of_guard = rows.theta.copy()
    for k in range(theta.shape[1]):
        ends = np.interp([rows.time[held], rows.time[held] + rows.weight[held]], time, theta[:, k])
        of_guard[held, :, k] = np.stack([ends.min(0), ends.max(0), ends.mean(0)], axis=1)
    return replace(rows, theta=of_guard)


def join(parts: Iterable[Rows]) -> Rows:
    """Return rows, one after the other; those of fewer channels have NaN for the others."""
    parts = list(parts)
    n = max(part.power.shape[1] for part in parts)
    parts = [replace(p, power=_filled(p.power, n), x=_filled(p.x, n)) for p in parts]
    return Rows(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Rows)))


def gather(rows: Rows, width: float) -> Rows:
    """Return intervals of `width` [s] that begin at its multiples.

    Changes of the mean within an interval count as oscillation: one that is slower than the rows is
    seen only so.
    """
    keys = np.floor(rows.time / width)
    starts = np.flatnonzero(np.r_[True, np.diff(keys) != 0])
    mean = _mean(rows.x[:, 2], rows.weight, starts)
    power = _mean(rows.power + rows.x[:, 2] ** 2, rows.weight, starts) - mean**2

    def table(values: Floats) -> Floats:
        parts = (
            np.fmin.reduceat(values[:, 0], starts),
            np.fmax.reduceat(values[:, 1], starts),
            _mean(values[:, 2], rows.weight, starts),
        )
        return np.stack(parts, axis=1)

    return Rows(
        keys[starts] * width,
        np.add.reduceat(rows.weight, starts),
        np.maximum(power, 0.0),
        *(table(getattr(rows, name)) for name in TABLES),
    )


def _mean(values: Floats, weight: Floats, starts: NDArray[np.int64]) -> Floats:
    """Return the mean of the finite values of each group; NaN of none."""
    finite = np.isfinite(values)
    total = np.add.reduceat(np.where(finite, values, 0.0) * weight[:, None], starts)
    share = np.add.reduceat(finite * weight[:, None], starts)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / share)
