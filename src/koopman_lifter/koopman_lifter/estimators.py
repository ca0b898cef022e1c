"""Estimates of K where the measurements are noisy, from the same sums as the least-squares one.

Least squares takes Psi_X for exact. Noise in it enlarges G, but not A, so that K comes out too
small: oscillations seem to die away faster than they do. Two estimates treat Psi_X and Psi_Y alike.

``total-least-squares`` (Hemati, Rowley, Deem and Cattafesta 2017): the directions of largest
variance of the stacked snapshots [x; y], the leading half of the eigenvectors [U_1; U_2] of
[[G, A^T], [A, L]], are those of the noise-free data if the noise is equally strong everywhere;
K = U_2 U_1^-1. The constant observable is exact (Golub and Van Loan 1980): the others are taken
about their means, in units of their deviation.

``forward-backward`` (Dawson, Hemati, Williams and Rowley 2016): K_f = A G^-1 from x to y and
K_b = A^T L^-1 from y to x shrink by the same factor, so it drops out of K^2 = K_f K_b^-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koopman_lifter.edmd import Gram, Koopman, edmd

ROUNDING = 1e-12  # the inverse of a matrix of a larger condition than 1 / ROUNDING says nothing


def total_least_squares(gram: Gram) -> Koopman:
    """Return K for equal errors in Psi_X and Psi_Y; argument and errors as of `edmd`."""
    plain = edmd(gram)
    now, cross, after = (gram.equilibrated(sums) for sums in (gram.xx, gram.yx, gram.yy))
    mean_now, mean_after = now[1:, 0], cross[1:, 0]  # the first observable is 1
    now = now[1:, 1:] - np.outer(mean_now, mean_now)
    cross = cross[1:, 1:] - np.outer(mean_after, mean_now)
    after = after[1:, 1:] - np.outer(mean_after, mean_after)
    deviation = np.sqrt(0.5 * (np.diag(now) + np.diag(after)))
    stacked = np.block([[now, cross.T], [cross, after]])
    _, vectors = np.linalg.eigh(stacked / np.outer(*2 * [np.tile(deviation, 2)]))
    half = deviation.size
    inner = _divided(vectors[half:, half:], vectors[:half, half:])
    inner = deviation[:, None] * inner / deviation
    scaled = np.zeros_like(plain.scaled)
    scaled[0, 0] = 1.0
    scaled[1:, 0] = mean_after - inner @ mean_now
    scaled[1:, 1:] = inner
    return _rescaled(plain, scaled)


def forward_backward(gram: Gram) -> Koopman:
    """Return K between its estimates forward and backward in time; as `edmd`."""
    plain = edmd(gram)
    cross, after = gram.equilibrated(gram.yx), gram.equilibrated(gram.yy)
    squares, vectors = np.linalg.eig(_divided(plain.scaled, _divided(cross.T, after)))
    squares = squares.astype(np.complex128)
    forward = np.diag(_divided_from_left(vectors, plain.scaled @ vectors))
    roots = np.sqrt(squares)
    # of the two roots the one that is nearer to what the same direction is multiplied by forward
    roots *= np.where((roots.conj() * forward).real < 0.0, -1.0, 1.0)
    second = np.flatnonzero(squares.imag < 0.0)  # of each pair; the first stands before it
    roots[second] = roots[second - 1].conj()
    # a negative square has no real root: noise has drowned that direction, which stays as it is
    drowned = (squares.imag == 0.0) & (squares.real < 0.0)
    roots[drowned] = forward[drowned].real
    return _rescaled(plain, _divided(vectors * roots, vectors).real)


ESTIMATORS: dict[str, Callable[[Gram], Koopman]] = {
    "least-squares": edmd,
    "total-least-squares": total_least_squares,
    "forward-backward": forward_backward,
}


def _rescaled(plain: Koopman, scaled: NDArray[np.float64]) -> Koopman:
    matrix = np.asarray(plain.scale[:, None] * scaled / plain.scale[None, :], dtype=np.float64)
    return replace(plain, matrix=matrix, scaled=scaled)


def _divided(numerator: NDArray[Any], denominator: NDArray[Any]) -> NDArray[Any]:
    """Return numerator denominator^-1."""
    return _divided_from_left(denominator.T, numerator.T).T


def _divided_from_left(denominator: NDArray[Any], numerator: NDArray[Any]) -> NDArray[Any]:
    """Return denominator^-1 numerator."""
    if np.linalg.cond(denominator) * ROUNDING > 1.0:
        raise ValueError(
            "the estimate is not determined by the data: record for longer, lower the degree, or "
            "use the least-squares estimator"
        )
    return np.asarray(np.linalg.solve(denominator, numerator))
