"""Distributions of metrics over seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from koop_study.simulation.run import Row
from koop_view.report.document import Cell, Column, Series

LONGEST = math.inf  # of a first hitting time that never comes


class Spread(NamedTuple):
    """Median and the 10 and 90 % quantiles."""

    median: float
    low: float
    high: float


def column(rows: Sequence[Row], name: str) -> list[float]:
    """Return one metric of all seeds; a first hitting time that never came is infinite."""
    return [LONGEST if row[name] is None else float(row[name] or 0.0) for row in rows]


def quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that at least ``share`` of all do not exceed.

    No interpolation: it would make nonsense of infinite values, and the result is a run that was.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    return float(ordered[max(0, math.ceil(share * ordered.size - 1e-9) - 1)])


def spread(rows: Sequence[Row], name: str) -> Spread:
    """Return the spread of a metric over seeds."""
    values = column(rows, name)
    return Spread(quantile(values, 0.5), quantile(values, 0.1), quantile(values, 0.9))


def share(rows: Sequence[Row], name: str) -> float:
    """Return the mean of a 0/1 metric in percent."""
    return 100.0 * float(np.mean(column(rows, name)))


def win_rate(rows: Sequence[Row], rivals: Sequence[Row]) -> float:
    """Return in percent how often a seed's IAE is below the rival's at the same seed."""
    pairs = zip(column(rows, "iae"), column(rivals, "iae"), strict=True)
    return 100.0 * float(np.mean([ours < theirs for ours, theirs in pairs]))


COLUMNS = (
    Column("iae_median", "IAE median", ".0f"),
    Column("iae_p10", "IAE 10 %", ".0f"),
    Column("iae_p90", "IAE 90 %", ".0f"),
    Column("ise_median", "ISE median", ".0f"),
    Column("t_theta_median", "T median [s]", ".0f"),
    Column("reached", "reached [%]", ".0f"),
    Column("converged", "converged [%]", ".0f"),
    Column("tail_median", "mean error, last 30 %, median", ".3f"),
    Column("e_r_ss_median", "e_r^ss median", ".5f"),
    Column("win_rate", "wins against raw [%]", ".0f"),
)


def summary_cells(rows: Sequence[Row], rivals: Sequence[Row] | None) -> tuple[Cell, ...]:
    """Return the cells of :data:`COLUMNS`; ``rivals`` are the same seeds with the raw cost."""
    return (
        *spread(rows, "iae"),
        spread(rows, "ise").median,
        finite(spread(rows, "t_theta").median),
        share(rows, "reached"),
        share(rows, "converged"),
        spread(rows, "tail").median,
        finite(spread(rows, "e_r_ss").median),
        None if rivals is None else win_rate(rows, rivals),
    )


def cumulative(curves: Mapping[str, Sequence[float]], total: int) -> tuple[Series, ...]:
    """Return the shares [%] of ``total`` runs that stay at or below a value, a curve a name.

    Values that are not finite and above 0 have no place on a logarithmic axis.
    """
    series = []
    for i, (name, values) in enumerate(curves.items()):
        ordered = np.sort(np.asarray(values, np.float64))
        shares = (np.arange(ordered.size) + 1.0) / total * 100.0
        positive = (ordered > 0.0) & np.isfinite(ordered)
        if positive.any():
            x, y = ordered[positive].tolist(), shares[positive].tolist()
            series.append(Series(name, x, y, "steps", color=i))
    return tuple(series)


def finite(value: float) -> float | None:
    """Return ``value``, or None if it is not finite."""
    return value if math.isfinite(value) else None
