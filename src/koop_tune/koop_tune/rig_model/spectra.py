"""Spectra where theta was held in a recording, and the period of what theta changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_identify.recording.loaded import Loaded
from koop_tune.rig.scale import Scale
from koop_tune.rig_model.dwells import DWELLS, find_rests, leave_out_short

TINY = 1e-300  # of a power: it has a logarithm


class Spectra(NamedTuple):
    """Spectra of the channels where theta rested.

    Attributes
    ----------
    seconds, dt : float
        Length of the segments of Welch's method, and time between two states [s].
    u : ndarray, shape (N,)
        Positions of the values of theta, rising.
    power : ndarray, shape (N, n, F)
        Mean densities over cycles a sample, from the second bin above 0 on.
    sure : ndarray of bool, shape (n, F)
        Where theta changes them, beyond doubt.
    """

    seconds: float
    dt: float
    u: NDArray[np.float64]
    power: NDArray[np.float64]
    sure: NDArray[np.bool_]

    @property
    def frequency(self) -> NDArray[np.float64]:
        """Frequency of each bin [Hz]."""
        return np.asarray((2 + np.arange(self.sure.shape[1])) / self.seconds)

    @property
    def density(self) -> NDArray[np.float64]:
        """Mean densities [1/Hz]."""
        return np.asarray(self.power * self.dt)


def spectra_by_theta(
    loaded: Loaded, scale: Scale, dt: float, length: int = DWELLS.window
) -> Spectra:
    """Return the spectra at each value of theta; a rest has some windows of ``length`` samples.

    Raises
    ------
    koop_core.errors.InputError
        If theta was held at too few values.
    """
    from scipy.signal import spectrogram, welch  # slow to import
    from scipy.stats import f_oneway

    u, rests = find_rests(loaded, scale, length)
    u, rests = leave_out_short(u, rests, DWELLS.part_of_spectra)
    usual = min(rest.end - rest.begin for rest in rests)
    size = min(DWELLS.longest_segment, usual)
    short = max(size // DWELLS.parts, 4)
    xs = [loaded.x[:, rest.begin : rest.end] for rest in rests]
    spectra = np.array([welch(x, nperseg=size, detrend="linear")[1][:, 2:] for x in xs])
    level = np.array([rest.level for rest in rests])
    change = _means_by(level, np.log(spectra + TINY), u.size).std(axis=0)
    # one rest tells no error: its parts do, which are coarser
    parts = [spectrogram(x, 1.0, "hann", short, 0, detrend="linear")[2] + TINY for x in xs]
    by_level = ([parts[i] for i in np.flatnonzero(level == k)] for k in range(u.size))
    logs = (np.log(np.concatenate(each, axis=-1)) for each in by_level)
    nearest = np.rint(np.arange(2, size // 2 + 1) * short / size).astype(int).clip(1, short // 2)
    chance = f_oneway(*logs, axis=-1).pvalue[:, nearest]
    sure = (change > DWELLS.change) & (chance < DWELLS.chance)
    return Spectra(size * dt, dt, u, _means_by(level, spectra, u.size), sure)


def _means_by(
    level: NDArray[np.int64], values: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    return np.array([values[level == i].mean(axis=0) for i in range(count)])
