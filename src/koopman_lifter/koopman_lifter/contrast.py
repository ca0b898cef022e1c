"""The ``contrast`` cost: y_out = (w^T X + c)^2, w where the oscillation stands out most.

What the data contain alike everywhere, such as interference, drops out: with C_hi and C_lo the mean
covariances of windows of strong and of weak oscillation w maximises w^T C_hi w / w^T C_lo w, a
generalised eigenvalue problem (common spatial patterns; Koles 1991, Fukunaga 1990). It is
restricted to the linear observables because an interference that is added to the state is additive
there and nowhere else. The result is a projector of the model file: the lifter runs it unchanged.

Windows are strong or weak by their amplitude, or, where theta of each window is known, by theta.
Then windows are put in bins of theta, every pair of bins proposes its directions, and the one is
taken whose energy (w^T X)^2 theta explains best: the largest ratio of the variance of its logarithm
between bins to that within them (Fisher's F), directions from one half of the windows being judged
on the other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koopman_lifter.delays import Delays
from koopman_lifter.model import KoopmanModel
from koopman_lifter.settings import LEARNING

Moments = tuple[NDArray[np.float64], NDArray[np.float64]]  # covariances, means


def with_contrast(
    model: KoopmanModel,
    covariances: NDArray[np.float64],
    means: NDArray[np.float64],
    theta: NDArray[np.float64] | None = None,
) -> KoopmanModel:
    """Return the model with the ``contrast`` projector in place of its dominant modes'.

    Parameters
    ----------
    model : KoopmanModel
        Model of an n-dimensional state.
    covariances : ndarray, shape (T, n, n)
        Covariances of the state over each of T windows of the data.
    means : ndarray, shape (T, n)
        Means of the state over the same windows.
    theta : ndarray, shape (T,), optional
        Control input of each window, if strong and weak are distinguished by it.

    Raises
    ------
    koop_core.errors.InputError
        If there are fewer than two windows, or a state, or a combination of states, never moves.
    """
    if len(covariances) < 2:
        raise InputError("the contrast needs weak and strong oscillation: two trajectories")
    if model.delays.count > 1:  # samples of a smooth signal nearly depend on each other
        n = covariances.shape[1]
        usual = np.trace(covariances.mean(axis=0)) / n
        covariances = covariances + LEARNING.ridge * usual * np.eye(n)
    try:
        if theta is None:
            direction, weak = _by_amplitude(covariances)
        else:
            direction, weak = _by_theta(covariances, theta)
    except np.linalg.LinAlgError:
        raise InputError(
            "a state, or a combination of states, never moves: it has no contrast"
        ) from None
    # the centre of the oscillation; a strong one is too slow for its mean to tell
    return _with_direction(model, direction, means[weak].mean(axis=0))


def with_band(model: KoopmanModel, windows: NDArray[np.float64], frequency: float) -> KoopmanModel:
    """Return the model with the direction whose power lies most within a band.

    The band is that of an oscillation (:func:`in_band`), and the direction the generalised
    eigenvector of the covariances within and beyond it (spatio-spectral decomposition; Nikulin,
    Nolte and Curio, NeuroImage 55, 2011): theta need not move for it.

    Parameters
    ----------
    model : KoopmanModel
    windows : ndarray, shape (T, channels, M)
        Consecutive samples.
    frequency : float
        Of the oscillation, in cycles a sample.
    """
    states = np.stack([model.delays.embed(window) for window in windows])
    lines = spectra(states)
    inside = in_band(states.shape[2], frequency)
    within, beyond = (
        np.einsum("tif,tjf->ij", part, part.conj()).real
        for part in (lines[..., inside], lines[..., ~inside])
    )
    beyond += LEARNING.ridge * np.trace(beyond) * np.eye(len(beyond))
    return _with_direction(
        model, _extremes(within[None], beyond[None])[:, -1], states.mean(axis=(0, 2))
    )


def spectra(windows: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the lines of windows, shape (T, n, M): those three bins away are out."""
    centred = windows - windows.mean(axis=2, keepdims=True)
    return np.asarray(np.fft.rfft(centred * np.blackman(windows.shape[2])))


def in_band(length: int, frequency: float) -> NDArray[np.bool_]:
    """Return which lines of windows lie within half a frequency of it, in cycles a sample."""
    return np.asarray(np.abs(np.fft.rfftfreq(length) - frequency) <= 0.5 * frequency)


def _with_direction(
    model: KoopmanModel, direction: NDArray[np.float64], mean: NDArray[np.float64]
) -> KoopmanModel:
    direction = direction / np.abs(direction).sum()
    rows = np.zeros((1, model.observables.p))
    rows[0, 1 : direction.size + 1] = direction
    rows[0, 0] = -direction @ mean
    return replace(model, projector=rows)


def can_split(theta: NDArray[np.float64] | None) -> bool:
    """Return whether theta of the windows is known and varied enough to split the windows."""
    if theta is None or not np.isfinite(theta).all() or theta.size < 2 * LEARNING.in_a_bin:
        return False
    bins = _bins(theta)
    return len(np.unique(bins[bins >= 0])) > 1


def _by_amplitude(
    covariances: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the direction, shape (n,), and which windows are weak."""
    count = max(1, round(LEARNING.quartile * len(covariances)))
    order = np.argsort(np.trace(covariances, axis1=1, axis2=2), kind="stable")
    weak, strong = order[:count], order[-count:]
    return _extremes(covariances[strong], covariances[weak])[:, -1], weak


def _by_theta(
    covariances: NDArray[np.float64], theta: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the direction, shape (n,), and which windows are weak: one bin of theta."""
    bins = _bins(theta)
    inside = [np.flatnonzero(bins == i) for i in np.unique(bins[bins >= 0])]
    halves = [(members[::2], members[1::2]) for members in inside]
    total = np.log(_relative(covariances, covariances).sum(axis=1))
    # which bins oscillate: what comes and goes with time is alike in all of them
    energy = np.array([total[members].mean() for members in inside])

    def separation(i: int, j: int, half: int) -> float:
        """F of the direction that two bins of one half propose, on the other half."""
        w = _extremes(covariances[halves[i][half]], covariances[halves[j][half]])[:, -1]
        judged = [members[1 - half] for members in halves]
        return _f_ratio([_log_energy(covariances[members], w) for members in judged])

    pairs = [
        (i, j) for i in range(len(inside)) for j in range(len(inside)) if energy[i] > energy[j]
    ]
    if not pairs:  # in each bin there is a window in which nothing moves
        raise np.linalg.LinAlgError("no bin oscillates more than another")
    i, j = max(pairs, key=lambda pair: sum(separation(pair[0], pair[1], half) for half in (0, 1)))
    return _extremes(covariances[inside[i]], covariances[inside[j]])[:, -1], inside[j]


def _bins(theta: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the bin of each window, -1 in none: as many windows in each, equal thetas in one."""
    count = min(LEARNING.bins, theta.size // LEARNING.in_a_bin)
    edges = np.unique(np.quantile(theta, np.linspace(0.0, 1.0, count + 1)))
    bins = np.searchsorted(edges[1:-1], theta, side="right")
    return np.where(np.bincount(bins)[bins] >= LEARNING.in_a_bin, bins, -1)


def _relative(
    covariances: NDArray[np.float64], reference: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the variances of the channels over their mean, shape (T, n)."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    usual = np.diagonal(reference, axis1=1, axis2=2).mean(axis=0)
    return np.asarray(variances / np.where(usual > 0.0, usual, 1.0))


def _extremes(strong: NDArray[np.float64], weak: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the directions in the order of their energy ratio, the largest last."""
    import scipy.linalg  # slow to import, and no other way of training needs it

    _, directions = scipy.linalg.eigh(strong.mean(axis=0), weak.mean(axis=0))
    return np.asarray(directions)


def _log_energy(covariances: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.log(np.einsum("i,tij,j->t", w, covariances, w)))


def _f_ratio(groups: list[NDArray[np.float64]]) -> float:
    """Return the variance between groups over that within them (one-way analysis of variance)."""
    everything = np.concatenate(groups)
    between = sum(g.size * (g.mean() - everything.mean()) ** 2 for g in groups)
    within = sum(((g - g.mean()) ** 2).sum() for g in groups)
    freedom = (everything.size - len(groups)) / max(len(groups) - 1, 1)
    return float(between / max(within, 1e-300) * freedom)


def moments(
    x: NDArray[np.float64], starts: NDArray[np.int64], length: int, delays: Delays
) -> Moments:
    """Return covariance and mean of the embedded state over windows of a recording.

    Parameters
    ----------
    x : ndarray, shape (channels, M)
        Measured channels, one dt apart within each window.
    starts : ndarray of int, shape (T,)
        First sample of each window.
    length : int
        Samples of a window, more than the delays span.
    delays : Delays
        What the state is.

    Returns
    -------
    covariances : ndarray, shape (T, n, n)
    means : ndarray, shape (T, n)
    """
    covariances, means = [], []
    for start in starts:
        window = delays.embed(x[:, start : start + length])
        covariances.append(np.atleast_2d(np.cov(window, bias=True)))
        means.append(window.mean(axis=1))
    return np.array(covariances), np.array(means)


def settled_moments(states: NDArray[np.float64], delays: Delays) -> Moments:
    """Return :func:`moments` of the settled part of a trajectory, shape (channels, M)."""
    settled = states[:, round(LEARNING.transient * states.shape[1]) :]
    return moments(settled, np.zeros(1, np.int64), settled.shape[1], delays)
