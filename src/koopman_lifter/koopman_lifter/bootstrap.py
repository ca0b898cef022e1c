"""How far the eigenvalues would move with other data of the same kind: a bootstrap over stretches.

The sums over the data are sums over its stretches. A data set drawn again, with replacement, from
the stretches needs no data, then: only another sum of some tens of matrices (block bootstrap,
Künsch 1989). It is honest as long as the stretches are long against what the system remembers.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from koopman_lifter.edmd import Gram, Koopman
from koopman_lifter.modes import averaged_over_pairs

RESAMPLES = 50  # the deviation of 50 draws is known to 10 %
FEWEST = 8  # stretches; fewer say nothing about their spread


def eigenvalue_spread(
    gram: Gram,
    eigenvalues: NDArray[np.complex128],
    solve: Callable[[Gram], Koopman],
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> NDArray[np.float64] | None:
    """Return the standard deviation of every eigenvalue in the complex plane.

    Parameters
    ----------
    gram : Gram
        Sums over the data and its stretches.
    eigenvalues : ndarray of complex, shape (p,)
        Of the operator that ``solve`` finds on all of the data.
    solve : callable
        From sums to the operator.
    resamples : int
        Data sets to draw.
    seed : int
        Of the draws: the same sums give the same figures.

    Returns
    -------
    ndarray, shape (p,), or None
        Root mean square distance of the eigenvalues of the drawn data sets from theirs, paired so
        that all distances together are least; equal within a complex pair. None if there are fewer
        than 8 stretches, or if most of the drawn data sets do not determine the operator.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and only training needs it

    if len(gram.stretches) < FEWEST or resamples < 2:
        return None
    rng = np.random.default_rng(seed)
    squares, drawn = np.zeros(eigenvalues.size), 0
    for _ in range(resamples):
        times = rng.multinomial(
            len(gram.stretches), [1.0 / len(gram.stretches)] * len(gram.stretches)
        )
        try:
            found = np.linalg.eigvals(solve(_drawn(gram, times)).scaled)
        except ValueError:
            continue
        distance = np.abs(eigenvalues[:, None] - found[None, :]) ** 2
        squares += distance[linear_sum_assignment(distance)]
        drawn += 1
    if 2 * drawn < resamples:
        return None
    return np.sqrt(averaged_over_pairs(eigenvalues, squares / drawn))


def _drawn(gram: Gram, times: NDArray[np.int64]) -> Gram:
    """Return the sums over a data set that holds every stretch so many times."""
    total = Gram.empty(gram.observables)
    for count, stretch in zip(times.tolist(), gram.stretches, strict=True):
        if count:
            total.xx += count * stretch.xx
            total.yx += count * stretch.yx
            total.yy += count * stretch.yy
            total.pairs += count * stretch.pairs
    return total
