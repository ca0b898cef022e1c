"""Where theta rested in a recording, and what the rig settled at. Pure: arrays in, figures out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from koop_identify.recording.loaded import Loaded, pieces
from koop_tune.excitation.features import Bands, features
from koop_tune.excitation.staircase import Visit as Seen
from koop_tune.excitation.staircase import judge, logarithmic, static_map

FEWEST = 4  # windows of a stay
LEAST = 2  # of them, that count
VALUES = 5  # of theta, that a map needs
STILL = 2e-3  # of theta's range by which it may move in a window and rest
DOUBT = 2.0  # standard errors
SHORTEST, LONGEST, PARTS = 16, 4096, 4  # samples; of a rest, whose spectra are averaged
PART_OF_USUAL = 0.5  # a shorter rest, such as one that lost messages cut, would blur the spectra
PART_OF_STAY = 0.25  # the same for the static map: the rest before an excitation is a short one
CHANGES = 0.3  # of the logarithm of a power, that theta must change
SAME = 0.02  # of the range, within which two values are one


@dataclass(frozen=True)
class Scale:
    """Position u of theta in its range, 0 to 1; by its logarithm where the limits are far apart."""

    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether it is that of log theta."""
        return logarithmic(self.low, self.high)

    def u(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions."""
        inside = np.clip(theta, self.low, self.high)
        if self.logarithmic:
            return np.asarray(np.log(inside / self.low) / math.log(self.high / self.low))
        return np.asarray((inside - self.low) / (self.high - self.low))

    def theta(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return theta at positions."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** np.asarray(u))
        return np.asarray(self.low + np.asarray(u) * (self.high - self.low))

    def theta_at(self, u: float) -> float:
        """Return theta at one position."""
        return float(self.theta(np.array(u)))


@dataclass(frozen=True)
class Stay:
    """A time in which theta rested.

    Attributes
    ----------
    level : int
        Number of its value.
    begin, end : int
        Samples; ``end`` is beyond the last whole window.
    skip : int
        Windows in which the rig settled.
    """

    level: int
    begin: int
    end: int
    skip: int


@dataclass(frozen=True)
class Stays:
    """All of them.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Positions of the values of theta, rising.
    stays : list of Stay
        In the order of the recording.
    how : Bands
        How windows are looked at.
    feature : int
        The amplitude that theta shows most in.
    amplitude : list of ndarray
        Its logarithm in each window of each stay.
    """

    u: NDArray[np.float64]
    stays: list[Stay]
    how: Bands
    feature: int
    amplitude: list[NDArray[np.float64]]

    def settled(self, windows: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return what is left of windows, stay by stay, once the rig had settled."""
        return [w[s.skip :] for s, w in zip(self.stays, windows, strict=True)]


def rests(
    loaded: Loaded, scale: Scale, length: int
) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    """Return the positions where theta rested, and (level, begin, end) of every rest.

    Raises
    ------
    ValueError
        If there are too few.
    """
    theta = loaded.theta
    if theta is None or not np.isfinite(theta).any():
        raise ValueError("the recording holds no theta: record with 'koop excite'")
    u = scale.u(theta)  # NaN stays NaN
    found = []
    for piece in pieces(loaded.begins):
        own = u[piece]
        moved = ~(np.abs(np.diff(own)) <= STILL / length)  # NaN moves
        bounds = _split(own, moved)
        for a, b in pairwise(bounds):
            whole = (b - a) // length
            if whole >= FEWEST and np.isfinite(own[a]):
                begin = piece.start + a
                found.append((float(np.median(own[a:b])), begin, begin + whole * length))
    ordered = sorted(value for value, _, _ in found)
    values: list[list[float]] = []
    for value in ordered:
        if not values or value - values[-1][0] > SAME:  # rests of a loop would form a chain
            values.append([])
        values[-1].append(value)
    if len(values) < VALUES:
        raise ValueError(
            f"theta rested at {len(values)} values for {FEWEST} windows of {length} samples: at "
            f"least {VALUES} are needed: record with koop excite"
        )
    centres = np.array([np.mean(group) for group in values])
    return centres, [(int(np.argmin(np.abs(centres - v))), a, b) for v, a, b in found]


def usual(
    u: NDArray[np.float64], found: list[tuple[int, int, int]], part: float
) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    """Leave out the rests that are shorter than a part of most, and values that have no other."""
    middle = float(np.median([b - a for _, a, b in found]))
    found = [rest for rest in found if rest[2] - rest[1] >= part * middle]
    kept, level = np.unique([i for i, _, _ in found], return_inverse=True)
    return u[kept], [(int(i), a, b) for i, (_, a, b) in zip(level, found, strict=True)]


class Spectra(NamedTuple):
    """Spectra of the channels where theta rested.

    Attributes
    ----------
    seconds, dt : float
        Length of the pieces of Welch's method, and time between two states [s].
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
        """Of each bin [Hz]."""
        return np.asarray((2 + np.arange(self.sure.shape[1])) / self.seconds)

    @property
    def density(self) -> NDArray[np.float64]:
        """Mean densities [1/Hz]."""
        return np.asarray(self.power * self.dt)


def spectra_by_theta(
    loaded: Loaded, scale: Scale, dt: float, length: int = SHORTEST, parts: int = PARTS
) -> Spectra:
    """Return the spectra at each value of theta.

    Parameters
    ----------
    loaded : Loaded
        The recording.
    scale : Scale
        Of theta.
    dt : float
        Time between two states [s].
    length : int
        Samples of a window; a rest has some.
    parts : int
        Pieces that even the shortest usual rest is cut into: fewer tell frequencies apart better.

    Raises
    ------
    ValueError
        If theta rested at too few values.
    """
    u, found = rests(loaded, scale, length)
    u, found = usual(u, found, PART_OF_USUAL)
    size = min(LONGEST, min(b - a for _, a, b in found) // parts)
    spectra = np.array(
        [welch(loaded.x[:, a:b], nperseg=size, detrend="linear")[1][:, 2:] for _, a, b in found]
    )
    level = np.array([i for i, _, _ in found])
    logs = np.log(spectra + 1e-300)
    means = np.array([logs[level == i].mean(axis=0) for i in range(u.size)])
    spread = means.std(axis=0)
    noise = (logs - means[level]).std(axis=0) * math.sqrt(u.size / level.size)
    sure = spread - DOUBT * noise > CHANGES
    power = np.array([spectra[level == i].mean(axis=0) for i in range(u.size)])
    return Spectra(size * dt, dt, u, power, sure)


def _split(u: NDArray[np.float64], moved: NDArray[np.bool_]) -> list[int]:
    """Return where rests begin and end; a way that is slower than what counts as rest is none."""
    bounds = [0, *(np.flatnonzero(moved) + 1).tolist(), u.size]
    slow = [a + np.flatnonzero(np.diff(u[a:b]) != 0.0) + 1 for a, b in pairwise(bounds)
            if b > a and np.ptp(u[a:b]) > SAME]  # fmt: skip
    return sorted({*bounds, *(int(k) for part in slow for k in part)})


def period_by_theta(loaded: Loaded, scale: Scale, dt: float) -> float | None:
    """Return the period [s] of what theta changes most of the spectrum; None if of nothing.

    An interference may be much stronger, and may come and go: it does not go with theta.
    """
    found = spectra_by_theta(loaded, scale, dt)
    change = np.where(found.sure, np.ptp(found.power, axis=0), 0.0)
    change /= np.maximum(loaded.x.var(axis=1, keepdims=True), 1e-300)
    if not found.sure.any():
        return None
    return float(found.seconds / (2 + int(np.argmax(change.sum(axis=0)))))


def find_stays(loaded: Loaded, scale: Scale, how: Bands, period: float) -> Stays:
    """Look at a recording of an oscillation of a period [s].

    The amplitude that counts is that of a channel, or of its band about the oscillation's
    frequency, whichever theta changes most, beyond doubt: what an interference adds changes less.

    Raises
    ------
    ValueError
        If theta rested at too few values.
    """
    length = how.length
    u, found = usual(*rests(loaded, scale, length), PART_OF_STAY)
    seen = [
        features(loaded.x[:, a:b].T.reshape(-1, length, loaded.x.shape[0]), how)
        for _, a, b in found
    ]
    each = seen[0].shape[1] // loaded.x.shape[0]
    guide = [i * each for i in range(loaded.x.shape[0])]
    line = round(length * how.dt / period)  # bin of the oscillation
    inside = [b for b, (low, high) in enumerate(pairwise(how.edges)) if low <= line < high]
    candidates = [i + 1 + b for i in guide for b in inside[:1]] + guide
    for _ in range(2):  # with all channels first, then with what theta shows most in
        visits, skips = [], []
        for (level, _, _), series in zip(found, seen, strict=True):
            judged = judge(series, guide)
            skips.append(min(judged.skip, series.shape[0] - LEAST))
            visits.append(Seen(level, tuple(judged.mean), tuple(judged.error), 0.0, 0.0))
        guide = [_most(visits, candidates, u.size)]
    feature = guide[0]
    stays = [Stay(*rest, skip) for rest, skip in zip(found, skips, strict=True)]
    return Stays(u, stays, how, feature, [series[:, feature] for series in seen])


def _most(visits: list[Seen], candidates: list[int], count: int) -> int:
    """Return the feature that theta changes most, less what its errors may feign."""

    def surely(feature: int) -> float:
        points = [p for p in static_map(visits, feature, count) if p is not None]
        spread = float(np.std([p.mean for p in points]))
        return spread - DOUBT * float(np.median([p.error for p in points]))

    return max(candidates, key=surely)


def window_levels(values: NDArray[np.float64], stays: Stays) -> list[NDArray[np.float64]]:
    """Return half the logarithm of the mean square of a signal, shape (M,), in each window."""
    length = stays.how.length
    tiny = 1e-300
    return [
        0.5 * np.log((values[s.begin : s.end].reshape(-1, length) ** 2).mean(axis=1) + tiny)
        for s in stays.stays
    ]
