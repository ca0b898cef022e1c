"""The ``contrast`` cost: y_out = (w^T x' + c)^2, w where strong oscillations exceed weak ones most.

What every window of the data contains alike, such as interference, drops out: with C_hi and C_lo
the mean covariances of the windows of largest and smallest amplitude w maximises

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

QUARTILE = 0.25  # share of the windows that counts as strongly, and as weakly, oscillating
TRANSIENT = 0.2  # share of a trajectory that is left out of its moments
WINDOW = 2000  # [samples] of a window, where a recording does not come in trajectories


def with_contrast(
    model: KoopmanModel, covariances: NDArray[np.float64], means: NDArray[np.float64]
) -> KoopmanModel:
    """Return the model with the ``contrast`` projector in place of its dominant modes'.

    Parameters
    ----------
    model : KoopmanModel
        Of n states.
    covariances : ndarray, shape (T, n, n)
        Of the measured state over each of T windows of the data, at least 2.
    means : ndarray, shape (T, n)
        Of the measured state over the same windows.

    Raises
    ------
    ValueError
        If a state, or a combination of states, never moves.
    """
    import scipy.linalg  # slow to import, and no other way of training needs it

    n = model.observables.n
    count = max(1, round(QUARTILE * len(covariances)))
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
    # without delays as many rows as of N modes: the format's version 1 knows no other number
    size = int(model.kept.sum()) if model.delays.count == 1 else 1
    rows = np.zeros((size, model.observables.p))
    rows[0, 1 : n + 1] = direction
    # the centre of the oscillation; a strong one is too slow for its mean to tell
    rows[0, 0] = -direction @ means[weak].mean(axis=0)
    return replace(model, projector=rows)


class WindowCovariances:
    """Covariance and mean of the measured state, window by window.

    Parameters
    ----------
    n : int
        Number of states.
    """

    def __init__(self, n: int) -> None:
        self._begun: NDArray[np.float64] = np.empty((n, 0))
        self._covariances: list[NDArray[np.float64]] = []
        self._means: list[NDArray[np.float64]] = []

    def add_trajectory(self, states: NDArray[np.float64]) -> None:
        """Take the settled part of a trajectory at one theta, shape (n, M)."""
        self._add(states[:, round(TRANSIENT * states.shape[1]) :])

    def add_recorded(self, states: NDArray[np.float64], begins: bool) -> None:
        """Take states, shape (n, M), that follow on the last ones unless ``begins``."""
        self._begun = states if begins else np.hstack((self._begun, states))
        while self._begun.shape[1] >= WINDOW:
            window, self._begun = np.split(self._begun, [WINDOW], axis=1)
            self._add(window)

    def _add(self, window: NDArray[np.float64]) -> None:
        self._covariances.append(np.atleast_2d(np.cov(window, bias=True)))
        self._means.append(window.mean(axis=1))

    def result(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return covariances, shape (T, n, n), and means, shape (T, n).

        Raises
        ------
        ValueError
            If there are fewer than two windows.
        """
        if len(self._means) < 2:
            raise ValueError(
                "the contrast needs weak and strong oscillation: two trajectories, or "
                f"{2 * WINDOW} recorded states; record longer, while theta moves over its range"
            )
        return np.array(self._covariances), np.array(self._means)
