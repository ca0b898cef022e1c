"""Extended dynamic mode decomposition from one-pass Gram matrices.

    K = argmin_K ||Psi_Y - K Psi_X||_F^2 = Psi_Y Psi_X^+   (paper section 3.2; Williams et al. 2015)

The data enter only through G = Psi_X Psi_X^T, A = Psi_Y Psi_X^T and, for what a mode is worth
(``koopman_lifter.modes``), L = Psi_Y Psi_Y^T: O(p^2) memory however long the recording is, and sums
over files or machines are sums of matrices. Monomials of a state of size 10
span eight decades, so G is scaled to unit diagonal before the solve (van der Sluis 1969); without
it a cut-off on singular values would drop whole observables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koop_core.errors import InputError
from koopman_lifter.observables import Monomials
from koopman_lifter.products import products


class RankDeficient(InputError):
    """The data do not excite every observable."""


@dataclass
class Gram:
    """Sums over snapshot pairs from which K and what its modes are worth follow."""

    observables: Monomials
    """The lifting g with p observables."""
    xx: NDArray[np.float64]
    """Shape (p, p): G = sum_k g(x_k) g(x_k)^T."""
    yx: NDArray[np.float64]
    """Shape (p, p): A = sum_k g(x_{k+1}) g(x_k)^T."""
    yy: NDArray[np.float64]
    """Shape (p, p): L = sum_k g(x_{k+1}) g(x_{k+1})^T."""
    pairs: int = 0
    """Number of snapshot pairs M."""

    @classmethod
    def empty(cls, observables: Monomials) -> Gram:
        """Return the sums over no data."""
        p = observables.p
        return cls(observables, np.zeros((p, p)), np.zeros((p, p)), np.zeros((p, p)))

    def of_degree(self, degree: int) -> Gram:
        """Return the sums over the monomials up to a lower degree: they come first."""
        observables = Monomials(self.observables.n, degree)
        p = observables.p
        return Gram(observables, self.xx[:p, :p], self.yx[:p, :p], self.yy[:p, :p], self.pairs)

    def add_trajectory(self, states: ArrayLike) -> None:
        """Add the consecutive pairs of one trajectory.

        Parameters
        ----------
        states : array_like, shape (n, M + 1)
            States at a uniform step, one a column. A gap needs two calls: the pair across it is no
            pair of consecutive states.

        Raises
        ------
        ValueError
            If the shape does not fit or a value is not finite; the sums are then unchanged.
        """
        array = np.asarray(states, dtype=np.float64)
        if array.ndim != 2 or array.shape[0] != self.observables.n:
            raise ValueError(
                f"a trajectory must have shape ({self.observables.n}, M), got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError("the trajectory holds a value that is not finite")
        if array.shape[1] > 1:
            xx, yx, yy = products(self.observables, array)
            self.xx += xx
            self.yx += yx
            self.yy += yy
            self.pairs += array.shape[1] - 1

    @property
    def scale(self) -> NDArray[np.float64]:
        """Root mean square of every observable over the data, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.xx) / self.pairs), dtype=np.float64)

    def equilibrated(self, sums: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``xx``, ``yx`` or ``yy`` as a mean over observables of unit root mean square."""
        scale = self.scale
        return np.asarray(sums / self.pairs / np.outer(scale, scale), dtype=np.float64)


@dataclass(frozen=True)
class Koopman:
    """A finite-dimensional Koopman operator estimate."""

    matrix: NDArray[np.float64]
    """Shape (p, p): K with z_{k+1} = K z_k."""
    scaled: NDArray[np.float64]
    """Shape (p, p): the same operator on observables of unit root mean square; the better
    conditioned one."""
    scale: NDArray[np.float64]
    """Shape (p,): root mean square of every observable: ``matrix = diag(scale) scaled diag(1 /
    scale)``."""
    condition: float
    """Condition number of the equilibrated Psi_X."""


def edmd(gram: Gram) -> Koopman:
    """Solve the least-squares problem for K.

    Parameters
    ----------
    gram : Gram
        Sums over at least p snapshot pairs.

    Returns
    -------
    Koopman
        The operator.

    Raises
    ------
    koop_core.errors.InputError
        If there are fewer pairs than observables; `RankDeficient` if the data do not excite every
        observable (equilibrated Psi_X rank deficient to double precision).
    """
    p = gram.observables.p
    if gram.pairs < p:
        raise InputError(
            f"{gram.pairs} snapshot pairs cannot determine {p} observables: record for longer"
        )
    scale = gram.scale
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        raise InputError("an observable is zero or overflows on all of the data: check the units")
    correlation = gram.equilibrated(gram.xx)
    eigenvalues = np.linalg.eigvalsh(correlation)
    if eigenvalues[0] <= p * np.finfo(float).eps * eigenvalues[-1]:
        raise RankDeficient(
            "the data do not excite every observable (rank deficient): "
            "record more varied trajectories, subtract offsets, lower the degree or take fewer "
            "delays, further apart"
        )
    cross = gram.equilibrated(gram.yx)
    scaled = np.asarray(np.linalg.solve(correlation, cross.T).T, dtype=np.float64)
    matrix = np.asarray(scale[:, None] * scaled / scale[None, :], dtype=np.float64)
    return Koopman(matrix, scaled, scale, float(np.sqrt(eigenvalues[-1] / eigenvalues[0])))
