"""Spectra of the channels by theta, and which of their lines are interference. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koop_tune.excitation.channels import Line, peaks
from koop_tune.rig_model.dwells import Spectra

FINE = 200  # bins that are kept as they are
COARSER = 1.02  # ratio of neighbouring frequencies above
HANN = 1.5  # bins that the window's power is spread over
NEAR = 2  # bins about a line


@dataclass(frozen=True)
class Peak:
    """A narrow line of a channel.

    Attributes
    ----------
    line : Line
        Of the spectrum averaged over theta, or of the quietest one.
    moved : bool
        Whether theta changes it; what it does not change is interference.
    least, most : float
        Amplitude of that sine over theta.
    """

    line: Line
    moved: bool
    least: float
    most: float


def lines_of(found: Spectra, channel: int) -> list[Peak]:
    """Return the narrow lines of a channel, the strongest first.

    Those that stand out on average, and those where the channel is quietest: there the oscillation
    hides no interference.
    """
    frequency = found.frequency
    sine = HANN / found.seconds  # from a density to the power of a sine
    power = found.density[:, channel] * sine
    marked: list[Peak] = []
    taken: list[int] = []
    quietest = power[int(np.argmin(power.sum(axis=1)))]
    # no peak is looked for at the first frequency that is given
    for line in (
        line
        for spectrum in (power.mean(axis=0), quietest)
        for line in peaks(np.r_[0.0, frequency], np.r_[0.0, spectrum])
    ):
        at = int(np.argmin(np.abs(frequency - line.frequency)))
        if any(abs(at - other) <= NEAR for other in taken):
            continue
        taken.append(at)
        about = slice(max(at - NEAR, 0), at + NEAR + 1)
        own = np.sqrt(2.0 * power[:, about].sum(axis=1) / HANN)
        moved = bool(found.sure[channel, about].any())
        marked.append(Peak(line, moved, float(own.min()), float(own.max())))
    return sorted(marked, key=lambda peak: -peak.most)


def groups(frequency: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the first bin of each group that is drawn as one: no eye sees the rest."""
    starts = list(range(min(FINE, frequency.size)))
    nxt = starts[-1] + 1
    while nxt < frequency.size:
        starts.append(nxt)
        nxt = max(nxt + 1, int(np.searchsorted(frequency, frequency[nxt] * COARSER)))
    return np.array(starts, np.int64)


def largest(values: NDArray[np.float64], starts: NDArray[np.int64]) -> Sequence[float]:
    """Return the largest value of each group."""
    return list(map(float, np.maximum.reduceat(values, starts)))


def least(values: NDArray[np.float64], starts: NDArray[np.int64]) -> Sequence[float]:
    """Return the least value of each group."""
    return list(map(float, np.minimum.reduceat(values, starts)))
