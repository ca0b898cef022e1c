"""Figures of merit of a cost on a recording: does r order what the rig did, and above its noise?

Pure arrays, so that a cost that no model file holds can be judged too. The order is

    starts, length = settled_windows(theta, begins, dt, skip)
    r = detected(y_out, begins, detector)
    merit(cut_windows(r, starts, length), oscillation(x, starts, length),
          cut_windows(theta, starts, length).mean(axis=1), dt, dwell)

The rank correlation is Spearman's: a relay follows the sign of a change of r, so any rising
function of the oscillation is as good as any other.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from koop_core.kernels import njit
from koop_core.stream.arrival import Arrival
from koop_loop.oscillation import amplitude
from koopman_lifter import cost
from koopman_lifter.cost import DetectorParams

UNTOLD = 20  # windows that a recording without theta is cut into
QUIET = 0.1  # share of theta's range by which theta may move within a window
LEAST = 0.1  # share of the windows that are called those of least r, or of least oscillation
SHORTER = 0.95  # than a settled stretch, so that one that is a little shorter counts, too
STEP = 0.1  # of theta's range, or of the windows in the order of their amplitude: see Merit.right
MOST = 2000  # windows that are compared with each other


@dataclass(frozen=True)
class Merit:
    """How well r tells of the oscillation.

    Attributes
    ----------
    windows : int
        Settled windows that were judged.
    rank_amplitude : float or None
        Rank correlation of the windows' mean r with their amplitude; 1 is perfect.
    rank_theta : float or None
        The same with the distance of theta from where the amplitude is least.
    theta_least_r, theta_least_amplitude : float or None
        Where r, and where the amplitude, is least: median theta of the least tenth of the windows.
    right : float or None
        How often r, averaged over one dwell, says rightly which of two windows is nearer to the
        optimum, where theta lies one dwell's move apart; 0.5 is chance. What the rig drifts
        between the windows counts as error. Without theta: which oscillates less, of windows a
        tenth of all apart.
    snr : float or None
        The same as a signal-to-noise ratio: the d' = sqrt(2) Phi^-1(right) of two normal
        distributions that are told apart as often.
    dwell : float
        Time of that average [s]: the dwell, or a window where that is shorter.
    """

    windows: int
    rank_amplitude: float | None
    rank_theta: float | None
    theta_least_r: float | None
    theta_least_amplitude: float | None
    right: float | None
    snr: float | None
    dwell: float

    @property
    def theta_offset(self) -> float | None:
        """By how much the theta of least r misses that of least amplitude."""
        if self.theta_least_r is None or self.theta_least_amplitude is None:
            return None
        return self.theta_least_r - self.theta_least_amplitude

    def as_dict(self) -> dict[str, float | int | None]:
        """Return the figures in JSON terms."""
        return {**asdict(self), "theta_offset": self.theta_offset}


@njit()
def _detected(
    p: DetectorParams, y_out: NDArray[np.float64], begins: NDArray[np.bool_], r: NDArray[np.float64]
) -> None:
    state = cost.initial()
    for k in range(y_out.shape[0]):
        arrival = Arrival.JOIN if begins[k] else Arrival.NEXT
        r[k], state = cost.follow(p, state, arrival, y_out[k])


def detected(
    y_out: NDArray[np.float64], begins: NDArray[np.bool_], params: DetectorParams
) -> NDArray[np.float64]:
    """Return r of energies, shape (M,); NaN while the detector settles after each begin.

    Parameters
    ----------
    y_out : ndarray, shape (M,)
        Instantaneous energies, one dt apart.
    begins : ndarray of bool, shape (M,)
        Whether a sample follows on none.
    params : DetectorParams
        Of the detector.
    """
    r = np.empty(y_out.size)
    _detected(params, y_out, begins, r)
    return r


def settled_windows(
    theta: NDArray[np.float64] | None,
    begins: NDArray[np.bool_],
    dt: float,
    skip: float,
    longest: float = math.inf,
) -> tuple[NDArray[np.int64], int]:
    """Cut a recording into windows of equal length in which theta rests, or nearly so.

    A stretch ends where the data or theta jump; what comes within ``skip`` after it is left out.
    The length follows from the data: at most what half of the settled samples have in one piece,
    and at most the time in which theta, where it always moves, moves by a tenth of its range.

    Parameters
    ----------
    theta : ndarray, shape (M,), or None
        Control input of every sample, NaN where it is not known; None if it was not recorded.
    begins : ndarray of bool, shape (M,)
        Whether a sample follows on none.
    dt : float
        Time between two samples [s].
    skip : float
        Time that the rig and the detector need after a jump [s].
    longest : float
        Longest window [s]; a window shorter than the slowest oscillation says little.

    Returns
    -------
    starts : ndarray of int, shape (K,)
        First sample of each window.
    length : int
        Samples of a window; 0 if there is none.
    """
    nothing = np.empty(0, np.int64), 0
    size, cut = begins.size, begins.copy()
    if not size:
        return nothing
    cut[0] = True
    moved, span = np.zeros(size), 0.0
    if theta is not None and np.isfinite(theta).any():
        known = np.isfinite(theta)
        span = float(np.nanmax(theta) - np.nanmin(theta))
        moved[1:] = np.nan_to_num(np.abs(np.diff(theta)))
        cut[1:] |= known[1:] != known[:-1]
        cut |= moved > QUIET * span
    bounds = np.append(np.flatnonzero(cut), size)
    usable = np.maximum(np.diff(bounds) - round(skip / dt), 0)
    if not usable.any():
        return nothing
    ordered = np.sort(usable)[::-1]
    half = ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())]
    limits = [longest / dt, SHORTER * half]
    speed = float(moved[~cut].mean()) if (~cut).any() else 0.0
    if speed > 0.0:
        limits.append(QUIET * span / speed)
    if span == 0.0:
        limits.append(ordered.sum() / UNTOLD)
    length = int(min(limits))
    if length < 3:
        return nothing
    starts = np.concatenate(
        [
            end - count + np.arange(count // length) * length
            for end, count in zip(bounds[1:], usable, strict=True)
        ]
    )
    if span > 0.0:
        assert theta is not None
        # NaN, where theta is not known, compares false
        rests = np.ptp(cut_windows(theta, starts, length), axis=1) <= 2.0 * QUIET * span
        starts = starts[rests]
    return starts, length


def cut_windows(
    values: NDArray[np.float64], starts: NDArray[np.int64], length: int
) -> NDArray[np.float64]:
    """Return the windows of a signal, shape (..., M), as shape (..., K, length)."""
    return np.asarray(values[..., starts[:, None] + np.arange(length)])


def oscillation(
    x: NDArray[np.float64], starts: NDArray[np.int64], length: int
) -> NDArray[np.float64]:
    """Return one amplitude of each window, shape (K,), of a state of n channels, shape (n, M).

    The root mean square of the channels' amplitudes (:func:`koop_loop.oscillation.amplitude`), each
    over its median over the windows, so that units do not matter.
    """
    of_channel = amplitude(cut_windows(x, starts, length))
    usual = np.median(of_channel, axis=1, keepdims=True)
    usual[usual == 0.0] = 1.0  # a channel that never moves
    return np.asarray(np.sqrt(((of_channel / usual) ** 2).mean(axis=0)))


def merit(
    r: NDArray[np.float64],
    amplitude: NDArray[np.float64],
    theta: NDArray[np.float64] | None,
    dt: float,
    dwell: float,
    swing: float | None = None,
) -> Merit:
    """Judge a cost on settled windows.

    Parameters
    ----------
    r : ndarray, shape (K, L)
        Cost after the detector in each of K windows; NaN where there is none.
    amplitude : ndarray, shape (K,)
        Of the oscillation in each window.
    theta : ndarray, shape (K,), or None
        Control input of each window; None if it was not recorded.
    dt : float
        Time between two samples [s].
    dwell : float
        The relay's dwell time [s].
    swing : float, optional
        What theta moves within one dwell; default a tenth of theta's range.
    """
    from scipy.stats import norm, rankdata  # slow to import

    part = max(1, min(round(dwell / dt), r.shape[1]))
    finite = np.isfinite(r)
    good = (finite.sum(axis=1) * 2 > r.shape[1]) & np.isfinite(amplitude)
    if theta is not None:
        good &= np.isfinite(theta)
        theta = theta[good]
        if not theta.size or np.ptp(theta) == 0.0:
            theta = None
    r, amplitude = r[good], amplitude[good]
    if r.shape[0] < 3:
        return Merit(r.shape[0], None, None, None, None, None, None, part * dt)
    mean = np.nanmean(r, axis=1)
    parts = r[:, : r.shape[1] // part * part].reshape(r.shape[0], -1, part).mean(axis=2)
    least_r = least_amplitude = rank_theta = None
    if theta is None:
        distance = rankdata(amplitude) / amplitude.size
        side: NDArray[np.bool_] = np.zeros(amplitude.size, np.bool_)
        step = STEP
    else:
        least_r, least_amplitude = _least(theta, mean), _least(theta, amplitude)
        distance = np.abs(theta - least_amplitude)
        rank_theta = rank(mean, distance)
        side, step = theta > least_amplitude, swing or float(np.ptp(theta)) * STEP
    found = _right(parts, distance, side, step)
    right = found[0] if found else None
    snr = None
    if found:
        bound = 0.5 / found[1]
        snr = float(math.sqrt(2.0) * norm.ppf(min(max(found[0], bound), 1.0 - bound)))
    return Merit(
        r.shape[0], rank(mean, amplitude), rank_theta, least_r, least_amplitude, right, snr,
        part * dt,
    )  # fmt: skip


def rank(a: NDArray[np.float64], b: NDArray[np.float64]) -> float | None:
    """Return Spearman's rank correlation; None where one of them is constant."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    from scipy.stats import spearmanr  # slow to import

    return float(spearmanr(a, b).statistic)


def _least(theta: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    count = max(1, round(LEAST * values.size))
    return float(np.median(theta[np.argsort(values, kind="stable")[:count]]))


def _right(
    r: NDArray[np.float64], distance: NDArray[np.float64], side: NDArray[np.bool_], step: float
) -> tuple[float, int] | None:
    """Return the share of pairs that r orders as the distance from the optimum does, and how many.

    A pair is of different windows on one side of the optimum, half to one and a half steps apart.
    """
    if r.shape[0] > MOST:
        chosen = np.linspace(0, r.shape[0] - 1, MOST).astype(np.int64)
        r, distance, side = r[chosen], distance[chosen], side[chosen]
    farther = distance[:, None] - distance
    pairs = (farther > 0.5 * step) & (farther < 1.5 * step) & (side[:, None] == side)
    count = right = 0.0
    for i, j in itertools.product(range(r.shape[1]), repeat=2):
        a, b = r[:, i][:, None], r[:, j]
        known = pairs & np.isfinite(a) & np.isfinite(b)
        count += np.count_nonzero(known)
        right += np.count_nonzero(known & (a > b)) + 0.5 * np.count_nonzero(known & (a == b))
    return (right / count, int(count)) if count else None
