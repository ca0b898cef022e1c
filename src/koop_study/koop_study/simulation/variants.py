"""Lifted costs beyond the paper's. Each is a projector W: y_out = ||W g(x')||_2^2.

``lifted``       the paper's: the N modes of largest energy, W from V_dom^+.
``log``          the same, and the logarithm of its energy.
``balanced``     the same modes, V_dom^+ taken on observables of unit root mean square.
``correlation``  the N modes whose energy ranks the trajectories most like their amplitude does.
``weighted``     all modes, non-negative least-squares weights that make the weighted modal energy
                 follow the trajectories' amplitude.
``contrast``     one direction of the linear observables: the one in which the strongly oscillating
                 trajectories exceed the weakly oscillating ones most, see koopman_lifter.contrast.

All of them are W of the existing model file, so that the lifter node runs them unchanged; ``log``
alone needs one more operation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koop_study.simulation.learning import Learned
from koopman_lifter.contrast import with_contrast
from koopman_lifter.edmd import Koopman, edmd
from koopman_lifter.model import KoopmanModel, build
from koopman_lifter.modes import Modes, decompose, partner, projector

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
    sensing = learned.sensing
    model = build(
        learned.gram, dt, sensing.names, modes, {"variant": variant}, sensing.embedding(dt)
    )
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
    from scipy.stats import spearmanr  # slow to import

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
    from scipy.optimize import nnls  # slow to import

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
    n = learned.gram.observables.n
    linear = slice(1, n + 1)
    return with_contrast(model, learned.covariances[:, linear, linear], learned.means[:, linear])


VARIANTS: dict[str, Callable[[KoopmanModel, Learned, Koopman, Modes], KoopmanModel]] = {
    "lifted": _paper,
    "log": _paper,
    "balanced": _balanced,
    "correlation": _correlation,
    "weighted": _weighted,
    "contrast": _contrast,
}
COSTS = ("raw", *VARIANTS)
