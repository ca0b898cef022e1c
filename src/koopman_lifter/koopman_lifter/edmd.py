"""Extended dynamic mode decomposition from one-pass Gram matrices.

    K = argmin_K ||Psi_Y - K Psi_X||_F^2 = Psi_Y Psi_X^+   (paper section 3.2; Williams et al. 2015)

The data enter only through G = Psi_X Psi_X^T, A = Psi_Y Psi_X^T and, for what a mode is worth
(``koopman_lifter.modes``), L = Psi_Y Psi_Y^T: O(p^2) memory however long the recording is, and sums
over files or machines are sums of matrices. Monomials of a state of size 10
span eight decades, so G is scaled to unit diagonal before the solve (van der Sluis 1969); without
it a cut-off on singular values would drop whole observables.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koopman_lifter.observables import Monomials
from koopman_lifter.products import products

BLOCK = 65536  # most pairs of a stretch while there are few
STRETCHES = 64  # of the data whose sums are kept, at most
STRETCH_BYTES = 2**28  # of their sums; fewer are kept of many observables


class RankDeficient(ValueError):
    """The data do not tell the observables apart."""


@dataclass
class Gram:
    """Sums over snapshot pairs from which K and what its modes are worth follow.

    Attributes
    ----------
    observables : Monomials
        The lifting g with p observables.
    xx : ndarray, shape (p, p)
        G = sum_k g(x_k) g(x_k)^T.
    yx : ndarray, shape (p, p)
        A = sum_k g(x_{k+1}) g(x_k)^T.
    yy : ndarray, shape (p, p)
        L = sum_k g(x_{k+1}) g(x_{k+1})^T.
    pairs : int
        Number of snapshot pairs M.
    stretches : list of Gram
        The same sums over consecutive stretches of the data, which have none of their own: what
        ``koopman_lifter.bootstrap`` draws from. Some tens, however much data there is.
    """

    observables: Monomials
    xx: NDArray[np.float64]
    yx: NDArray[np.float64]
    yy: NDArray[np.float64]
    pairs: int = 0
    stretches: list[Gram] = field(default_factory=list, repr=False)

    @classmethod
    def empty(cls, observables: Monomials) -> Gram:
        """Return the sums over no data."""
        p = observables.p
        return cls(observables, np.zeros((p, p)), np.zeros((p, p)), np.zeros((p, p)))

    def of_degree(self, degree: int) -> Gram:
        """Return the sums over the monomials up to a lower degree: they come first."""
        observables = Monomials(self.observables.n, degree)
        p = observables.p
        parts = [self, *self.stretches]
        total, *stretches = (
            Gram(observables, part.xx[:p, :p], part.yx[:p, :p], part.yy[:p, :p], part.pairs)
            for part in parts
        )
        total.stretches = stretches
        return total

    def add_trajectory(self, states: ArrayLike, longest: int = BLOCK) -> None:
        """Add the consecutive pairs of one trajectory.

        Parameters
        ----------
        states : array_like, shape (n, M + 1)
            States at a uniform step, one a column. A gap needs two calls: the pair across it is no
            pair of consecutive states.
        longest : int
            Most pairs of a stretch, while there are few stretches.

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
        block = min(longest, BLOCK)
        for start in range(0, array.shape[1] - 1, block):
            piece = array[:, start : start + block + 1]
            part = Gram(self.observables, *products(self.observables, piece), piece.shape[1] - 1)
            self._add(part)
            self._stretch([part])

    def __add__(self, other: Gram) -> Gram:
        if self.observables != other.observables:
            raise ValueError(f"cannot add Gram sums of {self.observables} and {other.observables}")
        total = Gram.empty(self.observables)
        for gram in (self, other):
            total._add(gram)
            total._stretch(gram.stretches)
        return total

    def _add(self, other: Gram) -> None:
        self.xx += other.xx
        self.yx += other.yx
        self.yy += other.yy
        self.pairs += other.pairs

    def _stretch(self, parts: list[Gram]) -> None:
        """Go on with the last stretch, or begin another one; join neighbours if they are many."""
        most = max_stretches(self.observables.p)
        usual = 2 * self.pairs // most
        for part in parts:
            if self.stretches and self.stretches[-1].pairs < usual:
                self.stretches[-1]._add(part)
            else:
                self.stretches.append(Gram.empty(self.observables))
                self.stretches[-1]._add(part)
            if len(self.stretches) > most:
                for one, next_one in zip(self.stretches[::2], self.stretches[1::2], strict=False):
                    one._add(next_one)
                self.stretches = self.stretches[::2]

    @property
    def scale(self) -> NDArray[np.float64]:
        """Root mean square of every observable over the data, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.xx) / self.pairs), dtype=np.float64)

    def equilibrated(self, sums: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``xx``, ``yx`` or ``yy`` as a mean over observables of unit root mean square."""
        scale = self.scale
        return np.asarray(sums / self.pairs / np.outer(scale, scale), dtype=np.float64)


def max_stretches(p: int) -> int:
    """Return of how many stretches the sums over p observables are kept, an even number."""
    return max(8, min(STRETCHES, STRETCH_BYTES // (3 * 8 * p**2) // 2 * 2))


@dataclass(frozen=True)
class Koopman:
    """A finite-dimensional Koopman operator estimate.

    Attributes
    ----------
    matrix : ndarray, shape (p, p)
        K with z_{k+1} = K z_k.
    scaled : ndarray, shape (p, p)
        The same operator on observables of unit root mean square; the better conditioned one.
    scale : ndarray, shape (p,)
        Root mean square of every observable: ``matrix = diag(scale) scaled diag(1 / scale)``.
    condition : float
        Condition number of the equilibrated Psi_X.
    """

    matrix: NDArray[np.float64]
    scaled: NDArray[np.float64]
    scale: NDArray[np.float64]
    condition: float


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
    ValueError
        If there are fewer pairs than observables; `RankDeficient` if the data do not excite every
        observable (equilibrated Psi_X rank deficient to double precision).
    """
    p = gram.observables.p
    if gram.pairs < p:
        raise ValueError(
            f"{gram.pairs} snapshot pairs cannot determine {p} observables: record for longer"
        )
    scale = gram.scale
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        raise ValueError("an observable is zero or overflows on all of the data: check the units")
    correlation = gram.equilibrated(gram.xx)
    eigenvalues = np.linalg.eigvalsh(correlation)
    if eigenvalues[0] <= p * np.finfo(float).eps * eigenvalues[-1]:
        raise RankDeficient(
            "the data do not excite every observable (rank deficient): "
            "record more varied trajectories, lower the degree or take fewer delays, further apart"
        )
    cross = gram.equilibrated(gram.yx)
    scaled = np.asarray(np.linalg.solve(correlation, cross.T).T, dtype=np.float64)
    matrix = np.asarray(scale[:, None] * scaled / scale[None, :], dtype=np.float64)
    return Koopman(matrix, scaled, scale, float(np.sqrt(eigenvalues[-1] / eigenvalues[0])))
