"""Two columns compared, row by row: how many differ, where first, and by how much at most."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

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
        Largest difference: infinite where only one side is a number, NaN for text.
    largest_at : int
        Its row.
    """

    count: int
    first: int
    largest: float
    largest_at: int


def column_diff(
    a: NDArray[Any], b: NDArray[Any], *, tolerance: float = 0.0, bitwise: bool = False
) -> ColumnDiff | None:
    """Compare two columns, shapes (n,) or (n, m); None if they are the same.

    Two that are not a number are equal.

    Parameters
    ----------
    a, b : ndarray
        Numbers, or objects such as text.
    tolerance : float
        Largest difference of two numbers that counts as equal.
    bitwise : bool
        Whether numbers that are equal but differ in a bit (0.0 and -0.0) are different.
    """
    if a.dtype == object or b.dtype == object:
        pairs = zip(a.astype(object), b.astype(object), strict=True)
        same: NDArray[np.bool_] = np.array(
            [x == y or (x != x and y != y) for x, y in pairs], np.bool_
        )
        distance = np.where(same, 0.0, math.nan)
    else:
        distance = _distance(a, b)
        unknown = (a != a) & (b != b)
        if bitwise:
            same = np.asarray((_bits(a) == _bits(b)) | unknown)
        else:
            same = np.asarray((a == b) | unknown | (distance <= tolerance))
        distance = np.where(same, 0.0, distance)
    if same.ndim > 1:
        same, distance = np.asarray(same.all(axis=1)), distance.max(axis=1)
    rows = np.flatnonzero(~same)
    if not rows.size:
        return None
    largest_at = int(rows[np.argmax(distance[rows])])
    return ColumnDiff(rows.size, int(rows[0]), float(distance[largest_at]), largest_at)


def _distance(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    if a.dtype == b.dtype and a.dtype.kind in "iu":
        # in integers: a float holds a stamp of today to 256 ns only
        return np.asarray(np.where(a > b, a - b, b - a), np.float64)
    with np.errstate(invalid="ignore"):
        distance = np.abs(a.astype(np.float64) - b.astype(np.float64))
    return np.asarray(np.where(np.isnan(distance), math.inf, distance))


def _bits(values: NDArray[Any]) -> NDArray[np.int64]:
    return np.ascontiguousarray(values, np.float64).view(np.int64)
