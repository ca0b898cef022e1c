"""Sums of a run under way: each sample adds a pair, and old pairs are forgotten where new ones say
the same.

Least squares with exponential forgetting, sum' = (1 - share) sum + new, lose what they know where
the loop does not excite: a controller that has converged brings the same state again and again, the
sums tend to those of that one state, and their inverse, which a recursive estimator carries along,
grows without bound (covariance wind-up; Astrom and Wittenmark 1995, section 11.5). Here forgetting
has a direction (after Kulhavy 1987, Cao and Schwartz 2000): with G = C C^T the sum of a past and D
that of a new block,

    C^-1 D C^-T = Q diag(gained) Q^T,     lost_i = min(share, gained_i / alertness)
    G' = C Q (1 - diag(lost)) Q^T C^T + D

so no direction loses more than a multiple of what it gains. In A and L the same pairs (x, K x) are
taken back: forgetting alone leaves K as it is. A block in which next to nothing moves, by the gains
of D about its mean, is left out. All of it is on observables of unit root mean square.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koopman_lifter.edmd import Gram
from koopman_lifter.observables import Monomials
from koopman_lifter.settings import RUNNING


class PairSums(NamedTuple):
    """What a block of consecutive samples is summed in.

    Attributes
    ----------
    xx, yx, yy : ndarray, shape (p, p)
        G, A and L of :class:`koopman_lifter.edmd.Gram`; of G and L the lower triangle.
    last : ndarray, shape (p,)
        Lifted state of the sample before.
    cursor : ndarray of int64, shape (3,)
        Pairs; whether there is a sample before; its step.
    """

    xx: NDArray[np.float64]
    yx: NDArray[np.float64]
    yy: NDArray[np.float64]
    last: NDArray[np.float64]
    cursor: NDArray[np.int64]


@njit()
def add(sums: PairSums, step: int, z: NDArray[np.float64]) -> None:
    """Add a lifted state, shape (p,); it is half of a pair where a step was lost before it."""
    last, cursor = sums.last, sums.cursor
    p = z.shape[0]
    for i in range(p):
        if not math.isfinite(z[i]):
            cursor[1] = 0
            return
    if cursor[1] == 1 and step == cursor[2] + 1:
        for i in range(p):
            before, now = last[i], z[i]
            for j in range(i + 1):
                sums.xx[i, j] += before * last[j]
                sums.yy[i, j] += now * z[j]
            for j in range(p):
                sums.yx[i, j] += now * last[j]
        cursor[0] += 1
    for i in range(p):
        last[i] = z[i]
    cursor[1], cursor[2] = 1, step


class RunningSums:
    """The sums of a run: those of its past, and those of the block that is being filled.

    Parameters
    ----------
    observables : Monomials
        The lifting g with p observables; memory is O(p^2).
    share : float
        Share of the past that a block replaces where it says the same; 0: nothing is forgotten.
    """

    def __init__(self, observables: Monomials, share: float) -> None:
        p = observables.p
        self.past = Gram.empty(observables)
        xx, yx, yy = np.zeros((3, p, p))
        self.block = PairSums(xx, yx, yy, np.zeros(p), np.zeros(3, dtype=np.int64))
        self._share = share

    @property
    def gram(self) -> Gram:
        """The sums over past and block."""
        return _joined(self.past, self._of_block())

    def close_block(self) -> Gram:
        """Let the block become a part of the past, begin another, and return what it summed.

        A block whose sums overflow, or in which next to nothing moves, is left out.
        """
        block = self._of_block()
        for array in self.block[:3]:
            array[:] = 0.0
        self.block.cursor[0] = 0
        if all(np.isfinite(sums).all() for sums in (block.xx, block.yx, block.yy)):
            self.past = absorb(self.past, block, self._share)
        return block

    def _of_block(self) -> Gram:
        xx, yx, yy, _, cursor = self.block
        whole = [np.tril(sums) + np.tril(sums, -1).T for sums in (xx, yy)]
        return Gram(self.past.observables, whole[0], yx.copy(), whole[1], int(cursor[0]))


def absorb(past: Gram, block: Gram, share: float) -> Gram:
    """Return the sums over a past and a block that replaces a share of it, see the module.

    A past that does not yet determine K is kept whole.
    """
    if share == 0.0 or past.pairs == 0 or block.pairs == 0 or not (past.scale > 0.0).all():
        return _joined(past, block)
    size = past.pairs * np.outer(past.scale, past.scale)
    now, cross, after = past.xx / size, past.yx / size, past.yy / size
    try:
        root = np.asarray(np.linalg.cholesky(now + RUNNING.ridge * np.eye(len(now))), np.float64)
    except np.linalg.LinAlgError:
        return _joined(past, block)
    about_mean = block.xx - np.outer(block.xx[0], block.xx[0]) / block.pairs
    if np.trace(_relative(root, about_mean / size)) < RUNNING.quiet * share:
        return past
    gained, directions = np.linalg.eigh(_relative(root, block.xx / size))
    lost = np.minimum(share, np.maximum(gained, 0.0) / RUNNING.alertness)
    predicted = np.linalg.solve(root, cross.T).T  # K C
    x, y = root @ directions * np.sqrt(lost), predicted @ directions * np.sqrt(lost)
    unexplained = after - predicted @ predicted.T
    xx = past.xx - size * (x @ x.T)
    kept = Gram(
        past.observables,
        xx,
        past.yx - size * (y @ x.T),
        past.yy - size * (y @ y.T + lost.mean() * unexplained),
        round(float(xx[0, 0])),  # of the constant observable
    )
    return _joined(kept, block)


def _relative(root: NDArray[np.float64], sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return C^-1 D C^-T."""
    return np.asarray(np.linalg.solve(root, np.linalg.solve(root, sums).T))


def _joined(a: Gram, b: Gram) -> Gram:
    return Gram(a.observables, a.xx + b.xx, a.yx + b.yx, a.yy + b.yy, a.pairs + b.pairs)
