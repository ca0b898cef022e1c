"""Two columns compared, row by row: how many differ, where first, and by how much at most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ColumnDiff:
    """Where two columns differ.

    Attributes
    ----------
    count : int
        Rows that differ.
    first : int
        The first of them.
    largest : float
        Largest difference: infinite where only one side is a number.
    largest_at : int
        Its row.
    """

    count: int
    first: int
    largest: float
    largest_at: int


def column_diff(a: NDArray[np.float64], b: NDArray[np.float64]) -> ColumnDiff | None:
    """Compare two columns bit by bit, shapes (n,) or (n, m); None if they are the same.

    Two that are not a number are equal; 0.0 and -0.0 are not.
    """
    same = (_bits(a) == _bits(b)) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        distance = np.abs(a - b)
    distance = np.where(same, 0.0, np.where(np.isnan(distance), np.inf, distance))
    if same.ndim > 1:
        same, distance = same.all(axis=1), distance.max(axis=1)
    rows = np.flatnonzero(~same)
    if not rows.size:
        return None
    largest_at = int(rows[np.argmax(distance[rows])])
    return ColumnDiff(rows.size, int(rows[0]), float(distance[largest_at]), largest_at)


def _bits(values: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.ascontiguousarray(values, np.float64).view(np.int64)
