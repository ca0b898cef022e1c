"""Where theta was held in a recording, and the amplitudes there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import parameter, validate
from koop_core.errors import InputError
from koop_identify.recording.loaded import Loaded, pieces
from koop_tune.excitation.features import Bands, log_amplitudes
from koop_tune.excitation.static_map import StaticMap
from koop_tune.excitation.visits import mean_level, summarise
from koop_tune.origin import studied
from koop_tune.rig.scale import Scale


@dataclass(frozen=True)
class DwellSettings:
    """Which rests of theta count, and what theta must change there."""

    fewest: int = studied(4, "windows of a rest", low=2)
    settled: int = studied(2, "windows of it that count at least", low=2)
    values: int = parameter(5, "values of a map", low=3, origin="a valley and both of its sides")
    still: float = studied(2e-3, "motion in a window at rest, in ranges", low=0.0, high=0.1)
    same: float = studied(0.02, "distance of two rests at one value, in ranges", low=0.0, high=0.1)
    part: float = parameter(
        0.25, "shortest rest over the usual one", low=0.0, high=1.0,
        origin="the rest before an excitation is a short one",
    )  # fmt: skip
    part_of_spectra: float = parameter(
        0.5, "the same for spectra", low=0.0, high=1.0, origin="rests that lost messages cut"
    )
    parts: int = studied(4, "pieces of the shortest rest whose spectra are averaged", low=1)
    change: float = studied(0.3, "change of a log power that theta makes", low=0.0)
    doubt: float = studied(2.0, "standard errors that are subtracted from a change", low=0.0)

    def __post_init__(self) -> None:
        validate(self)


DWELLS = DwellSettings()


class Rest(NamedTuple):
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
    skip: int = 0


@dataclass(frozen=True)
class Dwells:
    """All rests of a recording.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Positions of the values of theta, rising.
    rests : list of Rest
        In the order of the recording.
    bands : Bands
        How windows are looked at.
    feature : int
        The amplitude that theta shows most in.
    amplitude : list of ndarray
        Its logarithm in each window of each rest.
    """

    u: NDArray[np.float64]
    rests: list[Rest]
    bands: Bands
    feature: int
    amplitude: list[NDArray[np.float64]]

    def settled(self, windows: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return the windows after settling, rest by rest."""
        return [w[d.skip :] for d, w in zip(self.rests, windows, strict=True)]

    def static_map(self, windows: list[NDArray[np.float64]], sense: float) -> StaticMap:
        """Return the map of a quantity from its logarithm in the windows of each rest."""
        visits = []
        for rest, values in zip(self.rests, self.settled(windows), strict=True):
            mean, error = (float(part[0]) for part in mean_level(values[:, None]))
            visits.append(
                (rest.level, mean, error if math.isfinite(error) else float(np.ptp(values)))
            )
        return StaticMap.from_visits(self.u, visits, sense)

    def window_levels(self, values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return half the logarithm of the mean square of a signal, shape (M,), in each window."""
        length, tiny = self.bands.length, 1e-300
        return [
            0.5 * np.log((values[d.begin : d.end].reshape(-1, length) ** 2).mean(axis=1) + tiny)
            for d in self.rests
        ]


def find_rests(
    loaded: Loaded, scale: Scale, length: int, settings: DwellSettings = DWELLS
) -> tuple[NDArray[np.float64], list[Rest]]:
    """Return the positions where theta rested, and every rest, in windows of some samples.

    Raises
    ------
    koop_core.errors.InputError
        If there are too few.
    """
    theta = loaded.theta
    if theta is None or not np.isfinite(theta).any():
        raise InputError("the recording holds no theta: record with 'koop excite'")
    u = scale.u(theta)  # NaN stays NaN
    rests = []
    for piece in pieces(loaded.begins):
        part = u[piece]
        moved = ~(np.abs(np.diff(part)) <= settings.still / length)  # NaN moves
        for a, b in pairwise(_split(part, moved, settings.same)):
            whole = (b - a) // length
            if whole >= settings.fewest and np.isfinite(part[a]):
                begin = piece.start + a
                rests.append((float(np.median(part[a:b])), begin, begin + whole * length))
    values: list[list[float]] = []
    for value in sorted(value for value, _, _ in rests):
        if not values or value - values[-1][0] > settings.same:  # rests of a loop: no chain
            values.append([])
        values[-1].append(value)
    if len(values) < settings.values:
        raise InputError(
            f"theta rested at {len(values)} values for {settings.fewest} windows of {length} "
            f"samples: at least {settings.values} are needed: record with 'koop excite'"
        )
    centres = np.array([np.mean(group) for group in values])
    return centres, [Rest(int(np.argmin(np.abs(centres - v))), a, b) for v, a, b in rests]


def _split(u: NDArray[np.float64], moved: NDArray[np.bool_], same: float) -> list[int]:
    """Return where rests begin and end; a way that is slower than what counts as rest is none."""
    bounds = [0, *(np.flatnonzero(moved) + 1).tolist(), u.size]
    slow = [a + np.flatnonzero(np.diff(u[a:b]) != 0.0) + 1 for a, b in pairwise(bounds)
            if b > a and np.ptp(u[a:b]) > same]  # fmt: skip
    return sorted({*bounds, *(int(k) for part in slow for k in part)})


def leave_out_short(
    u: NDArray[np.float64], rests: list[Rest], part: float
) -> tuple[NDArray[np.float64], list[Rest]]:
    """Leave out the rests that are shorter than a part of most, and values that have no other."""
    middle = float(np.median([rest.end - rest.begin for rest in rests]))
    rests = [rest for rest in rests if rest.end - rest.begin >= part * middle]
    kept, level = np.unique([rest.level for rest in rests], return_inverse=True)
    return u[kept], [rest._replace(level=int(i)) for i, rest in zip(level, rests, strict=True)]


def find_dwells(
    loaded: Loaded, scale: Scale, bands: Bands, period: float, settings: DwellSettings = DWELLS
) -> Dwells:
    """Return the rests in a recording of an oscillation of a period [s].

    The amplitude that counts is that of a channel, or of its band about the oscillation's
    frequency, whichever theta changes most, beyond doubt: what an interference adds changes less.

    Raises
    ------
    koop_core.errors.InputError
        If theta rested at too few values.
    """
    length, n = bands.length, loaded.x.shape[0]
    u, rests = leave_out_short(*find_rests(loaded, scale, length, settings), settings.part)
    series = [
        log_amplitudes(loaded.x[:, a:b].T.reshape(-1, length, n), bands) for _, a, b, _ in rests
    ]
    each = series[0].shape[1] // n
    guides = [i * each for i in range(n)]
    line = round(length * bands.dt / period)  # bin of the oscillation
    inside = [b for b, (low, high) in enumerate(pairwise(bands.edges)) if low <= line < high]
    candidates = [i + 1 + b for i in guides for b in inside[:1]] + guides

    def change(feature: int) -> float:
        """Return the change of a feature with theta, less what its errors may explain."""
        visits = [(rest.level, float(s.mean[feature]), float(min(s.error[feature], 1e3)))
                  for rest, s in zip(rests, summaries, strict=True)]  # fmt: skip
        static_map = StaticMap.from_visits(u, visits, 1.0)
        return float(static_map.mean.std()) - settings.doubt * float(np.median(static_map.error))

    for _ in range(2):  # with all channels first, then with what theta shows most in
        summaries = [summarise(windows, guides) for windows in series]
        guides = [max(candidates, key=change)]
    rests = [
        rest._replace(skip=min(s.skip, windows.shape[0] - settings.settled))
        for rest, s, windows in zip(rests, summaries, series, strict=True)
    ]
    return Dwells(u, rests, bands, guides[0], [windows[:, guides[0]] for windows in series])
