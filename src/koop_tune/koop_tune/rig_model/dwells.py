"""Where theta was held in a recording, and the amplitudes there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, parameter
from koop_core.errors import InputError
from koop_identify.recording.loaded import Loaded, list_segments
from koop_tune.excitation.amplitude import Amplitude
from koop_tune.excitation.holds import (
    Hold,
    find_level,
    find_proven,
    longest_growth,
    mean_level,
    usual_wander,
)
from koop_tune.excitation.static_map import StaticMap
from koop_tune.origin import studied
from koop_tune.rig.scale import Scale


@dataclass(frozen=True)
class DwellSettings(Settings):
    """Which rests of theta count, and what theta must change there."""

    fewest: int = studied(4, "windows of a rest", low=2)
    settled: int = studied(2, "windows of it that count at least", low=2)
    values: int = parameter(5, "values of a map", low=1, origin="a valley and both of its sides")
    still: float = studied(2e-3, "motion in a window at rest, in ranges", low=0.0, high=0.1)
    same: float = studied(2e-3, "distance of two rests at one value, in ranges", low=0.0, high=0.1)
    part: float = parameter(
        0.1, "shortest rest over the usual one", low=0.0, high=1.0,
        origin="the rest before an excitation is a short one",
    )  # fmt: skip
    part_of_spectra: float = parameter(
        0.5, "the same for spectra", low=0.0, high=1.0, origin="rests that lost messages cut"
    )
    longest_segment: int = parameter(
        4096, "samples of a segment whose spectra are averaged, at most", low=16
    )
    window: int = parameter(16, "samples of a window of spectra", low=4)
    change: float = studied(0.3, "change of a log power that theta makes", low=0.0)
    parts: int = studied(16, "parts of a rest, which show how it changes by itself", low=2)
    chance: float = studied(0.01, "chance of a change that theta does not make", high=1.0)


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
    amplitude : Amplitude
        What is summed.
    logs : list of ndarray
        Its logarithm in each window of each rest.
    growth : float
        Longest time [s] in which it was seen to become worse.
    """

    u: NDArray[np.float64]
    rests: list[Rest]
    amplitude: Amplitude
    logs: list[NDArray[np.float64]]
    growth: float = 0.0

    @property
    def length(self) -> int:
        """Samples of a window."""
        return self.amplitude.windows.length

    def settled(self, windows: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return the windows after settling, rest by rest."""
        return [w[d.skip :] for d, w in zip(self.rests, windows, strict=True)]

    def static_map(self, windows: list[NDArray[np.float64]], sense: float) -> StaticMap:
        """Return the map of a quantity from its logarithm in the windows of each rest."""
        late = self.settled(windows)
        mean, error = np.array([mean_level(np.exp(2.0 * values)) for values in late]).T
        size = np.array([values.size for values in late])
        wander = usual_wander((error**2 * size).tolist())
        error = np.maximum(np.where(np.isfinite(error), error, 1.0), np.sqrt(wander / size))
        return StaticMap(self.u[[rest.level for rest in self.rests]], mean, error, sense)

    @property
    def middles(self) -> NDArray[np.float64]:
        """Sample in the middle of each rest."""
        return np.array([0.5 * (rest.begin + rest.end) for rest in self.rests])

    def now(self, static_map: StaticMap) -> tuple[StaticMap, Dwells]:
        """Return the map of the rests as it is now, and the rests where they would be now."""
        found = static_map.now(self.middles)
        u, level = np.unique(found.u, return_inverse=True)
        rests = [rest._replace(level=int(i)) for rest, i in zip(self.rests, level, strict=True)]
        return found, replace(self, u=u, rests=rests)

    def window_levels(self, values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return half the logarithm of the mean square of a signal, shape (M,), in each window."""
        return [
            0.5
            * np.log((values[d.begin : d.end].reshape(-1, self.length) ** 2).mean(axis=1) + 1e-300)
            for d in self.rests
        ]


def find_rests(loaded: Loaded, scale: Scale, length: int) -> tuple[NDArray[np.float64], list[Rest]]:
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
    pieces: list[list[tuple[float, int, int]]] = []  # of each rest, which lost messages cut
    for segment in list_segments(loaded.begins):
        part = u[segment]
        moved = ~(np.abs(np.diff(part)) <= DWELLS.still / length)  # NaN moves
        joins, finite = bool(pieces), [*np.isfinite(part).tolist(), False]
        for a, b in pairwise(_split(part, moved, DWELLS.same)):
            if not finite[a]:
                joins = bool(pieces)
                continue
            if b - a < DWELLS.fewest * length and not joins and finite[b]:
                continue  # theta moved on: most are of one sample
            value = float(np.median(part[a:b]))
            if not joins or abs(value - pieces[-1][-1][0]) > DWELLS.same:
                pieces.append([])
            joins = False
            pieces[-1].append((value, segment.start + a, segment.start + b))
    rests = [rest for each in pieces for rest in _settled(each, DWELLS.fewest, length)]
    values: list[list[float]] = []
    for value in sorted(value for value, _, _ in rests):
        if not values or value - values[-1][0] > DWELLS.same:  # rests of a loop: no chain
            values.append([])
        values[-1].append(value)
    if len(values) < DWELLS.values:
        raise InputError(
            f"theta was held at {len(values)} values for {DWELLS.fewest} windows of {length} "
            f"samples without a gap, the recording has {np.count_nonzero(loaded.begins)} parts: at "
            f"least {DWELLS.values} are needed: record with 'koop excite', without losses"
        )
    centres = np.array([np.mean(group) for group in values])
    return centres, [Rest(int(np.argmin(np.abs(centres - v))), a, b) for v, a, b in rests]


def _settled(
    pieces: list[tuple[float, int, int]], fewest: int, length: int
) -> list[tuple[float, int, int]]:
    """Return the pieces of a rest that are long enough, in whole windows, and that count.

    The rig may not have settled in the first half: of a rest that was cut, those of the second half
    count, and one that is as long as a half.
    """
    whole = [(v, a, a + (b - a) // length * length) for v, a, b in pieces]
    whole = [(v, a, b) for v, a, b in whole if b - a >= fewest * length]
    half, end = 0.5 * (pieces[-1][2] - pieces[0][1]), pieces[-1][2]
    return [(v, a, b) for v, a, b in whole if end - a <= half or b - a > half - length]


def _split(u: NDArray[np.float64], moved: NDArray[np.bool_], same: float) -> list[int]:
    """Return where rests begin and end; a way that is slower than what counts as rest is none."""
    bounds = [0, *(np.flatnonzero(moved) + 1).tolist(), u.size]
    slow = [a + np.flatnonzero(np.diff(u[a:b]) != 0.0) + 1 for a, b in pairwise(bounds)
            if b > a + 1 and np.ptp(u[a:b]) > same]  # fmt: skip
    return sorted({*bounds, *(int(k) for part in slow for k in part)})


def leave_out_short(
    u: NDArray[np.float64], rests: list[Rest], part: float
) -> tuple[NDArray[np.float64], list[Rest]]:
    """Leave out the rests that are shorter than a part of most, and values that have no other."""
    middle = float(np.median([rest.end - rest.begin for rest in rests]))
    return _only_held(u, [rest for rest in rests if rest.end - rest.begin >= part * middle])


def _only_held(u: NDArray[np.float64], rests: list[Rest]) -> tuple[NDArray[np.float64], list[Rest]]:
    """Leave out the values that have no rest."""
    kept, level = np.unique([rest.level for rest in rests], return_inverse=True)
    return u[kept], [rest._replace(level=int(i)) for i, rest in zip(level, rests, strict=True)]


def find_dwells(loaded: Loaded, scale: Scale, amplitude: Amplitude, sense: float) -> Dwells:
    """Return the rests that tell what a rig comes to, with the amplitude in each window.

    Raises
    ------
    koop_core.errors.InputError
        If theta was held at too few values.
    """
    u, rests = find_rests(loaded, scale, amplitude.windows.length)
    u, rests = leave_out_short(u, rests, DWELLS.part)
    squares = [
        amplitude.squares(amplitude.windows.powers(loaded.x[:, a:b].T)) for _, a, b, _ in rests
    ]
    levels = [find_level(amplitude, part) for part in squares]
    proven = find_proven(u[[rest.level for rest in rests]], levels, sense)
    columns = zip(rests, levels, squares, proven, strict=True)
    found = [
        (rest._replace(skip=min(level.skip, level.count - DWELLS.settled)), amplitude.log(part))
        for rest, level, part, counts in columns if counts
    ]  # fmt: skip
    u, rests = _only_held(u, [rest for rest, _ in found])
    growth = longest_growth(levels, sense) * amplitude.windows.seconds
    return Dwells(u, rests, amplitude, [logs for _, logs in found], growth)


def find_holds(loaded: Loaded, scale: Scale, length: int) -> list[Hold]:
    """Return the rests of a recording as the holds of an excitation.

    Raises
    ------
    koop_core.errors.InputError
        If theta was held at too few values.
    """
    u, rests = leave_out_short(*find_rests(loaded, scale, length), DWELLS.part)
    before = [float(u[rests[0].level]), *(float(u[rest.level]) for rest in rests)]
    return [
        Hold(float(u[r.level]), int(np.sign(u[r.level] - b)), loaded.x[:, r.begin : r.end].T)
        for r, b in zip(rests, before, strict=False)
    ]
