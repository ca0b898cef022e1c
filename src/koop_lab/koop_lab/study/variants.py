"""Lifted costs beyond the paper's. Each is a projector W: y_out = ||W g(x')||_2^2.

``lifted``       the paper's: the N modes of largest energy, W from V_dom^+.
``log``          the same, and the logarithm of its energy.
``balanced``     the same modes, V_dom^+ taken on observables of unit root mean square.
``correlation``  the N modes whose energy ranks the trajectories most like their amplitude does.
``weighted``     all modes, non-negative least-squares weights that make the weighted modal energy
                 follow the trajectories' amplitude.
``contrast``     one direction of the linear observables: the one in which the strongly oscillating
                 trajectories exceed the weakly oscillating ones most.

What every trajectory contains alike, such as interference, drops out of ``contrast``: with C_hi and
C_lo the mean covariances of the trajectories of largest and smallest amplitude it maximises

    w^T C_hi w / w^T C_lo w,

a generalised eigenvalue problem (common spatial patterns; Koles 1991, Fukunaga 1990). It is
restricted to the linear observables because an interference that is added to the state is additive
there and nowhere else. All of them are W of the existing model file, so that the lifter node runs
them unchanged; ``log`` alone needs one more operation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.stats import spearmanr

from koop_lab.study.learning import Learned
from koop_lab.train import STATE_NAMES
from koopman_lifter.edmd import Koopman, edmd
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.modes import Modes, decompose, partner, projector

QUARTILE = 0.25  # share of the trajectories that counts as strongly, and as weakly, oscillating
CORRELATION_MODES = 4  # N of ``correlation``


def make(variant: str, learned: Learned, dt: float, modes: int) -> KoopmanModel:
    """Return the model of a lifted cost.

    Parameters
    ----------
    variant : str
        A key of :data:`VARIANTS`.
    learned : Learned
        Training data.
    dt : float
        Time between consecutive states [s].
    modes : int
        N of the variants that keep the modes of largest energy.
    """
    model = build(learned.gram, dt, STATE_NAMES, modes, {"variant": variant})
    koopman = edmd(learned.gram)
    return VARIANTS[variant](model, learned, koopman, decompose(koopman, learned.gram))


def amplitudes(learned: Learned) -> NDArray[np.float64]:
    """Return each trajectory's mean square fluctuation of the measured state, shape (T,)."""
    n = learned.gram.observables.n
    linear = learned.covariances[:, 1 : n + 1, 1 : n + 1]
    return np.asarray(np.trace(linear, axis1=1, axis2=2))


def modal_rows(koopman: Koopman, modes: Modes) -> NDArray[np.complex128]:
    """Return V^-1, shape (p, p): row j takes z to the coordinate c_j of mode j."""
    inverse = np.linalg.inv(modes.vectors / koopman.scale[:, None])
    return np.asarray(inverse / koopman.scale[None, :])


def modal_fluctuations(learned: Learned, koopman: Koopman, modes: Modes) -> NDArray[np.float64]:
    """Return the variance of every modal coordinate over every trajectory, shape (T, p)."""
    rows = modal_rows(koopman, modes)
    return np.einsum("ij,tjk,ik->ti", rows, learned.covariances, rows.conj()).real


def _paper(model: KoopmanModel, learned: Learned, koopman: Koopman, modes: Modes) -> KoopmanModel:
    return model


def _balanced(
    model: KoopmanModel, learned: Learned, koopman: Koopman, modes: Modes
) -> KoopmanModel:
    scaled = modes.vectors[:, model.kept] / koopman.scale[:, None]
    rows = projector(scaled, modes.eigenvalues[model.kept]) / koopman.scale[None, :]
    return replace(model, projector=rows)


def _correlation(
    model: KoopmanModel, learned: Learned, koopman: Koopman, modes: Modes
) -> KoopmanModel:
    target = amplitudes(learned)
    fluctuations = modal_fluctuations(learned, koopman, modes)
    constant = fluctuations.max(axis=0) <= 1e-12 * modes.energies
    score = np.array(
        [
            -1.0 if constant[j] else float(spearmanr(fluctuations[:, j], target).statistic)
            for j in range(modes.energies.size)
        ]
    )
    kept = np.zeros(score.size, dtype=np.bool_)
    for j in np.argsort(-score, kind="stable"):
        if kept.sum() >= CORRELATION_MODES:
            break
        kept[[j, partner(modes.eigenvalues, int(j))]] = True
    v_dom = modes.vectors[:, kept]
    return replace(
        model, kept=kept, V_dom=v_dom, projector=projector(v_dom, modes.eigenvalues[kept])
    )


def _weighted(
    model: KoopmanModel, learned: Learned, koopman: Koopman, modes: Modes
) -> KoopmanModel:
    target = amplitudes(learned)
    fluctuations = modal_fluctuations(learned, koopman, modes)
    scale = fluctuations.mean(axis=0)
    scale[scale <= 1e-12 * modes.energies] = np.inf  # the constant mode gets no weight
    # relative errors: the amplitudes span decades and the small ones matter near the optimum
    weights, _ = nnls(fluctuations / scale / target[:, None], np.ones(target.size))
    gains = np.sqrt(weights / scale)
    rows, everything = modal_rows(koopman, modes), np.ones(weights.size, dtype=np.bool_)
    real_rows = np.zeros((weights.size, weights.size))
    for j in range(weights.size):
        mate = partner(modes.eigenvalues, j)
        if mate == j:
            real_rows[j] = gains[j] * rows[j].real
        else:  # both of a pair have the same |c|^2: one row takes the real, one the imaginary part
            gain = np.hypot(gains[j], gains[mate])
            real_rows[j] = gain * (rows[j].real if j < mate else rows[mate].imag)
    return replace(model, kept=everything, V_dom=modes.vectors, projector=real_rows)


def _contrast(
    model: KoopmanModel, learned: Learned, koopman: Koopman, modes: Modes
) -> KoopmanModel:
    n, p = learned.gram.observables.n, learned.gram.observables.p
    order = np.argsort(amplitudes(learned), kind="stable")
    count = max(1, round(QUARTILE * order.size))
    weak, strong = order[:count], order[-count:]
    linear = learned.covariances[:, 1 : n + 1, 1 : n + 1]
    _, directions = scipy.linalg.eigh(linear[strong].mean(axis=0), linear[weak].mean(axis=0))
    direction = directions[:, -1] / np.abs(directions[:, -1]).sum()
    rows = np.zeros((int(model.kept.sum()), p))  # as many as a model file of N modes has
    rows[0, 1 : n + 1] = direction
    # the centre of the oscillation; a strong one is too slow for its mean to tell
    rows[0, 0] = -direction @ learned.means[weak, 1 : n + 1].mean(axis=0)
    return replace(model, projector=rows)


VARIANTS: dict[str, Callable[[KoopmanModel, Learned, Koopman, Modes], KoopmanModel]] = {
    "lifted": _paper,
    "log": _paper,
    "balanced": _balanced,
    "correlation": _correlation,
    "weighted": _weighted,
    "contrast": _contrast,
}
COSTS = ("raw", *VARIANTS)
