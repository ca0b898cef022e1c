"""What a window of the measured channels says about the oscillation.

The amplitude of each channel, and that in bands of frequency: where an interference hides the
oscillation, one of the bands does not have it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_loop.oscillation import amplitude

BANDS = 6
KEPT = 0.999  # of the power, that the bands cover
FLOOR = 1e-12  # of an amplitude, so that nothing at all has a logarithm


class Bands(NamedTuple):
    """How windows are looked at.

    Attributes
    ----------
    length : int
        Samples of a window.
    edges : tuple of int
        Bins of its spectrum, from the lowest to beyond the highest.
    dt : float
        Time between two samples [s].
    """

    length: int
    edges: tuple[int, ...]
    dt: float

    def names(self, channels: Sequence[str]) -> list[str]:
        """Return what each feature is, in words."""
        hertz = [edge / (self.length * self.dt) for edge in self.edges]
        bands = [f" from {a:.3g} to {b:.3g} Hz" for a, b in itertools.pairwise(hertz)]
        return [f"{name}{band}" for name in channels for band in ("", *bands)]


def choose_bands(x: NDArray[np.float64], length: int, dt: float) -> Bands:
    """Choose bands for windows of a length, from samples, shape (M, n)."""
    spectrum = np.zeros(length // 2 + 1)
    for start in range(0, x.shape[0] - length + 1, length):
        part = _detrended(x[start : start + length])
        scale = np.maximum(part.std(axis=0), FLOOR)
        spectrum += (
            np.abs(np.fft.rfft(part * np.hanning(length)[:, None] / scale, axis=0)) ** 2
        ).sum(axis=1)
    below = np.cumsum(spectrum[1:])
    top = 2 + int(np.searchsorted(below, KEPT * below[-1])) if below[-1] > 0.0 else spectrum.size
    top = min(max(top, BANDS + 1), spectrum.size)
    edges = np.unique(np.round(np.geomspace(1, top, BANDS + 1)).astype(int))
    return Bands(length, tuple(int(edge) for edge in edges), dt)


def log_amplitudes(x: NDArray[np.float64], bands: Bands) -> NDArray[np.float64]:
    """Return the logarithms of the amplitudes of windows, channel by channel.

    Parameters
    ----------
    x : ndarray, shape (..., length, n)
        The samples of each window; NaN is bridged.
    bands : Bands
        Bands of the rig.

    Returns
    -------
    ndarray, shape (..., n * (1 + bands))
        For each channel that of all frequencies, then that of each band.
    """
    if not np.isfinite(x).all():
        x = np.reshape([bridge_gaps(w) for w in x.reshape(-1, *x.shape[-2:])], x.shape)
    power = np.abs(np.fft.rfft(_detrended(x) * np.hanning(x.shape[-2])[:, None], axis=-2)) ** 2
    whole = amplitude(np.swapaxes(x, -1, -2))
    total = np.maximum(power[..., 1:, :].sum(axis=-2), FLOOR)
    inside = [power[..., a:b, :].sum(axis=-2) / total for a, b in itertools.pairwise(bands.edges)]
    rows = np.stack([whole, *(whole * np.sqrt(share) for share in inside)], axis=-1)
    return np.asarray(np.log(np.maximum(rows, FLOOR)).reshape(*x.shape[:-2], -1))


def bridge_gaps(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return samples, shape (M, n), with those that are not finite taken from their neighbours."""
    if np.isfinite(x).all():
        return x
    places, result = np.arange(x.shape[0]), x.copy()
    for j in range(x.shape[1]):
        finite = np.isfinite(x[:, j])
        result[:, j] = np.interp(places, places[finite], x[finite, j]) if finite.any() else 0.0
    return result


def window_length(period: float, periods: float, dt: float) -> int:
    """Return the samples of a window of some periods; at least 64."""
    return max(64, math.ceil(periods * period / dt))


def _detrended(x: NDArray[np.float64]) -> NDArray[np.float64]:
    t = np.linspace(-1.0, 1.0, x.shape[-2])
    centred = x - x.mean(axis=-2, keepdims=True)
    slope = np.einsum("t,...tn->...n", t, centred) / (t @ t)
    return np.asarray(centred - t[:, None] * slope[..., None, :])
