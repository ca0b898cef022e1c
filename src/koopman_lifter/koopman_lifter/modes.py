"""Koopman modes: eigenvalues, energies, residuals and the choice of the dominant ones.

Eigenvalues, energies and the choice by energy are the paper's (section 3.3). The residual of a mode
tells whether its eigenvalue is one of the system or of the matrix only (Colbrook, Ayton and Szoke
2023). With the left eigenvector w, w* K = lambda w*, the eigenfunction is phi(x) = w* g(x), and

    res^2 = w* (L - conj(lambda) A - lambda A^T + |lambda|^2 G) w / w* G w,

with the sums of ``koopman_lifter.edmd.Gram``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koopman_lifter.edmd import Gram, Koopman


@dataclass(frozen=True)
class Modes:
    """Eigen-decomposition K V = V diag(lambda), largest |lambda| first."""

    eigenvalues: NDArray[np.complex128]
    """Shape (p,): lambda_j; a complex pair stands together."""
    vectors: NDArray[np.complex128]
    """Shape (p, p): V, right eigenvectors as columns of unit 2-norm."""
    energies: NDArray[np.float64]
    """Shape (p,): E_j = mean over the training data of |c_j|^2, c = V^+ g(x'); equal within a
    complex pair."""
    residuals: NDArray[np.float64]
    """Shape (p,): root mean square error of phi_j(x_{k+1}) = lambda_j phi_j(x_k) over that of
    phi_j; equal within a complex pair. What is below 1e-7 is rounding."""


def decompose(koopman: Koopman, gram: Gram) -> Modes:
    """Return the modes of ``koopman`` with energies and residuals on the data summed in ``gram``.

    The eigenvectors are found on the equilibrated operator and scaled back. The energies need no
    second pass over the data: mean |c_j|^2 is the j-th diagonal element of V^-1 (G / M) V^-H.
    """
    eigenvalues, scaled_vectors = np.linalg.eig(koopman.scaled)
    order = np.lexsort((-eigenvalues.imag, -eigenvalues.real, -np.round(np.abs(eigenvalues), 12)))
    eigenvalues = eigenvalues[order].astype(np.complex128)
    vectors = koopman.scale[:, None] * scaled_vectors[:, order].astype(np.complex128)
    norms = np.linalg.norm(vectors, axis=0)
    vectors = vectors / norms
    correlation = gram.equilibrated(gram.xx)
    # c = V^-1 z and V = diag(scale) W, so c = W^-1 (z / scale) with W of good condition
    inverse = np.linalg.inv(vectors / koopman.scale[:, None])
    energies = _quadratic(inverse, correlation).real
    return Modes(
        eigenvalues,
        vectors,
        averaged_over_pairs(eigenvalues, energies),
        averaged_over_pairs(eigenvalues, residuals(eigenvalues, inverse, gram)),
    )


def residuals(
    eigenvalues: NDArray[np.complex128], left: NDArray[np.complex128], gram: Gram
) -> NDArray[np.float64]:
    """Return the residual of every pair of eigenvalue and eigenfunction, shape (m,).

    ``left``, shape (m, p), has the rows w_j*, on observables of unit root mean square.
    """
    now, cross, after = (
        _quadratic(left, gram.equilibrated(sums)) for sums in (gram.xx, gram.yx, gram.yy)
    )
    squares = after.real - 2.0 * (eigenvalues.conj() * cross).real
    squares += np.abs(eigenvalues) ** 2 * now.real
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) / now.real), dtype=np.float64)


def _quadratic(rows: NDArray[np.complex128], matrix: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return r M r* of every row r."""
    return np.asarray(np.sum((rows @ matrix) * rows.conj(), axis=1))


def partner(eigenvalues: NDArray[np.complex128], j: int) -> int:
    """Return the index of the complex conjugate of mode ``j``; ``j`` itself if it is real."""
    if eigenvalues[j].imag == 0.0:
        return j
    return int(np.argmin(np.abs(eigenvalues - eigenvalues[j].conj())))


def select(modes: Modes, count: int) -> NDArray[np.bool_]:
    """Choose the ``count`` modes of largest energy and never split a complex pair.

    If the cut falls inside a pair, the pair is kept whole and one mode more than asked for is
    returned: half of a pair is not a real-valued quantity.

    Parameters
    ----------
    modes : Modes
        p of them.
    count : int
        N, 1 to p.

    Returns
    -------
    ndarray of bool, shape (p,)
        True for a mode that is kept.

    Raises
    ------
    koop_core.errors.InputError
        If ``count`` is not within 1..p.
    """
    p = modes.energies.size
    if not 1 <= count <= p:
        raise InputError(f"cannot keep {count} of {p} modes: choose 1 to {p}")
    kept = np.zeros(p, dtype=np.bool_)
    for j in np.argsort(-modes.energies, kind="stable"):
        if kept.sum() >= count:
            break
        kept[[j, partner(modes.eigenvalues, int(j))]] = True
    return kept


def projector(
    v_dom: NDArray[np.complex128], eigenvalues: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Return the real matrix W with ||W z||_2 = ||V_dom^+ z||_2 for every real z.

    Parameters
    ----------
    v_dom : ndarray of complex, shape (p, N)
        Kept right eigenvectors, closed under conjugation.
    eigenvalues : ndarray of complex, shape (N,)
        Their eigenvalues.

    Returns
    -------
    ndarray, shape (N, p)
        A real mode contributes its row of V_dom^+; a complex pair, whose rows are conjugate,
        contributes sqrt(2) times the real and the imaginary part of one of them.
    """
    q, r = np.linalg.qr(v_dom)
    rows = np.linalg.solve(r, q.conj().T)  # no direction is cut: they are linearly independent
    real_rows = []
    for j, eigenvalue in enumerate(eigenvalues):
        if eigenvalue.imag == 0.0:
            real_rows.append(rows[j].real)
        elif eigenvalue.imag > 0.0:
            real_rows += [np.sqrt(2.0) * rows[j].real, np.sqrt(2.0) * rows[j].imag]
    return np.array(real_rows, dtype=np.float64)


def averaged_over_pairs(
    eigenvalues: NDArray[np.complex128], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give both of a pair the same value to the last bit, so that sorting keeps them together."""
    mates = np.array([partner(eigenvalues, j) for j in range(eigenvalues.size)])
    return 0.5 * (values + values[mates])
