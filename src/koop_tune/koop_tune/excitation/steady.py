"""Lines that no theta changes: sines whose phase runs on through all holds.

Two tones of an interference beat, and may take longer for that than theta is held: their power then
differs from hold to hold as if theta changed it. But the phase of a tone runs on whatever theta
does, and that of an oscillation wanders, and turns faster or slower where theta is another.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from koop_tune.excitation.amplitude import Windows, bridge_gaps
from koop_tune.excitation.holds import Hold

LINES, FITS = 2, 8  # sines that are fitted, and how often one of them, less the others
PARTS = 8  # of a window: windows begin on a grid of them
PADDED = 4  # times the length of a series: its peak is found between bins


def unsteady_shares(
    windows: Windows, holds: Sequence[Hold], channel: int, group: int
) -> NDArray[np.float64]:
    """Return the share of a group's power in each hold that sines of one phase in all leave.

    Parameters
    ----------
    windows : Windows
        How samples are cut.
    holds : sequence of Hold
        H holds of one recording, of two windows or more, of which the second half counts; one of
        which it is not known when it began has no share.
    channel, group : int
        The channel, and the group of frequencies, whose strongest bin is looked at.
    """
    step = max(windows.length // PARTS, 1)
    bins, places = np.arange(*windows.edges[group : group + 2]), np.arange(windows.length)
    turned = np.exp(-2j * np.pi * np.outer(places / windows.length, bins))
    turned *= np.blackman(windows.length)[:, None]
    spectra, starts, numbers = [], [], []
    for number, hold in enumerate(holds):
        if math.isnan(hold.began):
            continue
        first = round(hold.began / windows.dt) + hold.size // 2
        skipped = hold.size // 2 - first % step
        x = bridge_gaps(hold.x[skipped:, channel : channel + 1])[:, 0]
        cut = sliding_window_view(x, windows.length)[:: PARTS * step]
        spectra.append((cut - cut.mean(axis=1, keepdims=True)) @ turned)
        starts.append(first // step + PARTS * np.arange(cut.shape[0]))
        numbers += [number] * cut.shape[0]
    if len(numbers) < FITS * LINES:
        return np.ones(len(holds))
    spectrum, at = np.concatenate(spectra), np.concatenate(starts)
    values = spectrum[:, (np.abs(spectrum) ** 2).sum(axis=0).argmax()]
    at -= at.min()
    series = np.zeros(PADDED << int(at.max()).bit_length(), complex)
    turns: list[float] = []
    for _ in range(FITS):
        series[at] = _subtract(values, at, turns[1 - LINES :])
        turns.append(_peak(np.abs(np.fft.fft(series))))
    left = _subtract(values, at, turns[-LINES:])
    own, rest = (np.bincount(numbers, np.abs(v) ** 2, len(holds)) for v in (values, left))
    return np.asarray(rest / np.maximum(own, 1e-300))


def _subtract(
    values: NDArray[np.complex128], at: NDArray[np.int64], turns: Sequence[float]
) -> NDArray[np.complex128]:
    """Return values, shape (W,), at places less sines of so many turns from place to place."""
    sines = np.exp(2j * np.pi * np.outer(at, turns))
    return np.asarray(values - sines @ np.linalg.lstsq(sines, values, rcond=None)[0])


def _peak(spectrum: NDArray[np.float64]) -> float:
    """Return where a spectrum has its peak, as a share of its length: a parabola through three."""
    peak, size = int(spectrum.argmax()), spectrum.size
    before, most, after = np.log(
        np.maximum(spectrum.take([peak - 1, peak, peak + 1], mode="wrap"), 1e-300)
    )
    bend = before - 2.0 * most + after
    return (peak + 0.5 * (before - after) / bend if bend else peak) / size
