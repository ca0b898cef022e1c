"""What is wrong with a measured channel, and its spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, parameter
from koop_tune.excitation.amplitude import bridge_gaps, find_step

WIDTH = 2  # bins to each side that belong to a line under a Hann window


@dataclass(frozen=True)
class ChannelSettings(Settings):
    """When values count as quantised or at a stop, and a peak of a spectrum as a line."""

    stop: float = parameter(0.01, "share of the samples at an extreme that is a stop", low=0.0)
    flatter: float = parameter(3.0, "that share over the share of a sine", low=1.0)
    fewest: int = parameter(128, "samples before which there is no spectrum", low=2)
    shortest: int = parameter(64, "samples of a segment of a spectrum at least", low=8)
    segment: float = parameter(0.25, "segment of a spectrum, over the record", low=0.0, high=1.0)
    line: float = parameter(8.0, "power of a line over the spectrum around it", low=1.0)
    around: int = parameter(12, "bins to each side of that", low=3)
    share: float = parameter(0.02, "power of a line over the whole", low=0.0, high=1.0)
    lines: int = parameter(4, "lines that are named at most", low=1)


CHANNELS = ChannelSettings()


class ChannelSummary(NamedTuple):
    """One measured channel.

    Attributes
    ----------
    low, high, deviation : float
        Range and standard deviation.
    bad : float
        Share of samples that are not finite.
    held : float
        Longest part of the record in which the value is one and the same, as a share.
    quantum : float
        Step between neighbouring values; 0: none is seen.
    saturated : float
        Share of samples at an end of the range, where that is a stop; else 0.
    """

    low: float
    high: float
    deviation: float
    bad: float
    held: float
    quantum: float
    saturated: float

    @property
    def dead(self) -> bool:
        """Whether it says nothing."""
        return self.bad == 1.0 or self.low == self.high


class Line(NamedTuple):
    """A narrow peak of a spectrum: frequency [Hz], amplitude of that sine, share of the power."""

    frequency: float
    amplitude: float
    share: float


def describe_channel(x: NDArray[np.float64]) -> ChannelSummary:
    """Look at the samples of one channel, shape (M,)."""
    usable = x[np.isfinite(x)]
    bad = 1.0 - usable.size / max(x.size, 1)
    if not usable.size:
        return ChannelSummary(math.nan, math.nan, math.nan, 1.0, 1.0, 0.0, 0.0)
    low, high = float(usable.min()), float(usable.max())
    changes = np.flatnonzero(np.diff(usable) != 0.0)
    rests = np.diff(changes, prepend=-1, append=usable.size - 1)
    step = float(find_step(usable[:, None])[0])
    quantum = step if math.isfinite(step) else 0.0
    return ChannelSummary(
        low, high, float(usable.std()), bad, float(rests.max()) / usable.size, quantum,
        _saturated(usable, low, high, quantum),
    )  # fmt: skip


def _saturated(x: NDArray[np.float64], low: float, high: float, quantum: float) -> float:
    """Return the share at the stops: far more than a sine spends within a quantum of its end."""
    swing = 0.5 * (high - low)
    if swing == 0.0:
        return 0.0
    usual = math.acos(max(1.0 - max(quantum, 1e-6 * swing) / swing, -1.0)) / math.pi
    shares = [float(np.mean(x == end)) for end in (low, high)]
    return sum(share for share in shares if share > max(CHANNELS.stop, CHANNELS.flatter * usual))


def find_lines(x: NDArray[np.float64], dt: float) -> list[Line]:
    """Return the narrow peaks of a channel's spectrum, the strongest first.

    By Welch's method, about a straight line in each segment. At least the largest peak is named.

    Parameters
    ----------
    x : ndarray, shape (M,)
        Evenly spaced samples; those that are not finite are bridged.
    dt : float
        Time between two [s].
    """
    from scipy.signal import welch  # slow to import

    finite = np.isfinite(x)
    if finite.sum() < CHANNELS.shortest or np.ptp(x[finite]) == 0.0:
        return []
    x = bridge_gaps(x[:, None])[:, 0]
    length = max(CHANNELS.shortest, int(CHANNELS.segment * x.size))
    frequency, power = welch(x, 1.0 / dt, "hann", length, detrend="linear", scaling="spectrum")
    return pick_lines(frequency, power)


def pick_lines(frequency: NDArray[np.float64], power: NDArray[np.float64]) -> list[Line]:
    """Return the narrow peaks of a spectrum under a Hann window, the strongest first.

    Parameters
    ----------
    frequency : ndarray, shape (F,)
        Frequency of each bin [Hz]; the first one is left out.
    power : ndarray, shape (F,)
        Power of a sine at that frequency.
    """
    # bins of the window overlap by 1.5: their sum is the power of what lies in them
    total = float(power[1:].sum()) / 1.5
    named: list[Line] = []
    rest = power.copy()
    rest[0] = 0.0
    while len(named) < CHANNELS.lines and rest.any():
        peak = int(np.argmax(rest))
        if power[max(peak - 1, 1) : peak + 2].max() > power[peak]:  # the foot of one that was named
            rest[peak] = 0.0
            continue
        inner = slice(max(peak - WIDTH, 1), peak + WIDTH + 1)
        power_inside = power[inner]
        outer = np.r_[
            power[max(peak - CHANNELS.around, 1) : inner.start],
            power[inner.stop : peak + CHANNELS.around],
        ]
        share = float(power_inside.sum()) / 1.5 / total
        narrow = power[peak] > CHANNELS.line * np.median(outer) if outer.size else True
        if named and not (narrow and share > CHANNELS.share):
            break
        at = float(np.average(frequency[inner], weights=power_inside))
        named.append(Line(at, math.sqrt(2.0 * float(power_inside.sum()) / 1.5), share))
        rest[inner] = 0.0
    return named


def strongest_period(x: NDArray[np.float64], dt: float) -> float | None:
    """Return the period of the strongest oscillation of samples, shape (M, n) [s]; None if none."""
    named = [peaks[0] for column in x.T if (peaks := find_lines(column, dt))]
    return 1.0 / max(named, key=lambda line: line.share).frequency if named else None


def should_listen(
    x: NDArray[np.float64], dt: float, least: float, periods: float, most: float,
) -> bool:  # fmt: skip
    """Return whether more must be heard: some periods of what is strongest, not for ever [s].

    What is strongest shows only when it is heard long enough, so this is asked again and again.
    """
    heard = x.shape[0] * dt
    if heard < max(least, CHANNELS.fewest * dt):
        return True
    period = strongest_period(x, dt)
    return period is not None and heard < min(periods * period, most)
