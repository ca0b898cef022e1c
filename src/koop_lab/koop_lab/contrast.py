"""The ``contrast`` cost: y_out = (w^T x' + c)^2, w where strong oscillations exceed weak ones most.

What every stretch of data contains alike, such as interference, drops out: with C_hi and C_lo the
mean covariances of the stretches of largest and smallest amplitude w maximises

    w^T C_hi w / w^T C_lo w,

a generalised eigenvalue problem (common spatial patterns; Koles 1991, Fukunaga 1990). It is
restricted to the linear observables because an interference that is added to the state is additive
there and nowhere else. The result is a projector of the existing model file, so that the lifter
node runs it unchanged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koopman_lifter.model import KoopmanModel

QUARTILE = 0.25  # share of the stretches that counts as strongly, and as weakly, oscillating
WINDOW = 2000  # [samples] of a stretch, where a recording does not come in trajectories


def with_contrast(
    model: KoopmanModel, covariances: NDArray[np.float64], means: NDArray[np.float64]
) -> KoopmanModel:
    """Return the model with the ``contrast`` projector in place of its dominant modes'.

    Parameters
    ----------
    model : KoopmanModel
        Of n states.
    covariances : ndarray, shape (T, n, n)
        Of the measured state over each of T stretches of data, at least 2.
    means : ndarray, shape (T, n)
        Of the measured state over the same stretches.

    Raises
    ------
    ValueError
        If there are too few stretches, or a state (or a combination of states) never moves.
    """
    import scipy.linalg  # slow to import, and no other way of training needs it

    n = model.observables.n
    count = max(1, round(QUARTILE * len(covariances)))
    if len(covariances) < 2 * count:
        raise ValueError(f"{len(covariances)} stretches of data: the contrast needs at least 2")
    order = np.argsort(np.trace(covariances, axis1=1, axis2=2), kind="stable")
    weak, strong = order[:count], order[-count:]
    try:
        _, directions = scipy.linalg.eigh(
            covariances[strong].mean(axis=0), covariances[weak].mean(axis=0)
        )
    except np.linalg.LinAlgError:
        raise ValueError(
            "a state, or a combination of states, never moves: it has no contrast"
        ) from None
    direction = directions[:, -1] / np.abs(directions[:, -1]).sum()
    rows = np.zeros((int(model.kept.sum()), model.observables.p))  # as many as of N modes
    rows[0, 1 : n + 1] = direction
    # the centre of the oscillation; a strong one is too slow for its mean to tell
    rows[0, 0] = -direction @ means[weak].mean(axis=0)
    return replace(model, projector=rows)


class Windows:
    """Cuts stretches of states into windows of equal length and keeps their moments.

    Parameters
    ----------
    n : int
        Number of states.
    """

    def __init__(self, n: int) -> None:
        self._states: NDArray[np.float64] = np.empty((n, 0))
        self._covariances: list[NDArray[np.float64]] = []
        self._means: list[NDArray[np.float64]] = []

    def add(self, states: NDArray[np.float64], begins: bool) -> None:
        """Take states, shape (n, M), that follow on the last ones unless a stretch begins."""
        self._states = states if begins else np.hstack((self._states, states))
        while self._states.shape[1] >= WINDOW:
            window, self._states = np.split(self._states, [WINDOW], axis=1)
            self._covariances.append(np.atleast_2d(np.cov(window, bias=True)))
            self._means.append(window.mean(axis=1))

    def moments(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return covariances, shape (T, n, n), and means, shape (T, n), of all whole windows.

        Raises
        ------
        ValueError
            If there are fewer than two.
        """
        if len(self._means) < 2:
            raise ValueError(
                f"the contrast needs two stretches of {WINDOW} states, at weak and at strong "
                "oscillation: record longer, while theta moves over its range"
            )
        return np.array(self._covariances), np.array(self._means)
