"""Where theta goes next, how long it stays, and when the static map is known. Pure: no ROS.

Theta goes up and down through its values, then through them at random, so that neither a memory of
the rig nor a drift is taken for the map. At each value the amplitude is taken in one window after
the other; the level is the logarithm of its root mean square. What comes before the rig has
settled is left out: the d windows for which the marginal standard error of the rest is least
(White, Simulation 69 (1997) 323-334),

    d = argmin_{d <= m/2} var(a_d .. a_m) / (m - d)

and as long as d is at that end, the rig is still settling. The standard error of the rest counts
that neighbouring windows are alike. Theta stays until it is small enough: longer where it is noisy.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_tune.excitation import optimum_test

LEVELS = 9
LOGARITHMIC = 20.0  # ratio of the limits of theta, from which on its values are a geometric series
FEWEST = 6  # windows at a value
LONGER = 2.0  # than the rig was seen to need, theta stays at least
FLOOR = 0.03  # of an amplitude: no map need be known better
SHARE = 0.05  # of the map's span, that is good enough
MOST_VISITS, MOST_IN_DOUBT = 6, 16
CLIFF = 4.0  # ratio of amplitudes at the best value and at one beside it: one between is added
CLIFF_ERRORS = 2.0  # standard errors that it is beyond
FINEST = 0.04  # of the range, within which none is
ADDED = 4  # values at most
LINGER = 48  # windows that theta stays beside a cliff at least
LEAST_ERROR = 0.003  # of an amplitude: nothing is known better


@dataclass(frozen=True)
class Visit:
    """What was seen at one value of theta.

    Attributes
    ----------
    level : int
        Number of the value.
    mean, error : tuple of float
        Of each feature, after the rig had settled; its standard error.
    settled : float
        Time that the rig needed [s].
    stay : float
        Time that theta was there [s].
    """

    level: int
    mean: tuple[float, ...]
    error: tuple[float, ...]
    settled: float
    stay: float


class Judged(NamedTuple):
    """What the windows at one value say so far.

    Attributes
    ----------
    skip : int
        Windows that are left out: the rig was settling.
    settled : bool
        Whether that is over.
    mean, error : ndarray, shape (f,)
        Of each feature.
    """

    skip: int
    settled: bool
    mean: NDArray[np.float64]
    error: NDArray[np.float64]


class Point(NamedTuple):
    """One value of the static map: mean and error of a feature, and how often theta was there."""

    mean: float
    error: float
    visits: int


def logarithmic(low: float, high: float) -> bool:
    """Return whether theta is looked at by its logarithm: its limits are far apart by a factor."""
    return low > 0.0 and high / low >= LOGARITHMIC


def away(theta: float, low: float, high: float, share: float) -> float:
    """Return the value that is a share of the range from theta, towards the end further off.

    >>> away(1.0, 0.5, 8.0, 0.25), away(1.0, 0.5, 50.0, 0.5)
    (2.875, 10.0)
    """
    if logarithmic(low, high):
        up = high / theta >= theta / low
        return theta * (high / low) ** (share if up else -share)
    up = high - theta >= theta - low
    return theta + share * (high - low) * (1 if up else -1)


def values(low: float, high: float, count: int = LEVELS) -> list[float]:
    """Return the values of theta: evenly spaced, or by a factor where the limits are far apart.

    >>> values(0.5, 50.0, 3)
    [0.5, 5.0, 50.0]
    """
    if logarithmic(low, high):
        return [low * (high / low) ** (i / (count - 1)) for i in range(count - 1)] + [high]
    return [low + (high - low) * i / (count - 1) for i in range(count - 1)] + [high]


def judge(series: NDArray[np.float64], guide: Sequence[int]) -> Judged:
    """Judge the windows at one value.

    Parameters
    ----------
    series : ndarray, shape (m, f)
        Features of each window, m at least 2.
    guide : sequence of int
        The features that tell when the rig has settled.
    """
    m = series.shape[0]
    most = m // 2
    skip = 0
    for j in guide:
        skip = max(skip, int(np.argmin(_worth(series[:, j], most))))
    rest = series[skip:]
    return Judged(skip, skip < most, *level(rest))


def _worth(values: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Return var(a_d .. a_m) / (m - d) for d up to ``most``."""
    backwards = values[::-1] - values.mean()
    count = np.arange(1, values.size + 1)
    mean = np.cumsum(backwards) / count
    variance = np.maximum(np.cumsum(backwards**2) / count - mean**2, 0.0)
    return np.asarray((variance / count)[::-1][: most + 1])


def level(rest: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the logarithm of the root mean square of each column's exponential, and its error.

    The mean of the logarithm would be lower the more an amplitude comes and goes in a window, and
    less sure: by a third for the one of a noise-driven oscillation.
    """
    top = rest.max(axis=0)
    power = np.exp(2.0 * (rest - top))
    mean = power.mean(axis=0)
    return top + 0.5 * np.log(mean), 0.5 * standard_error(power) / mean


def standard_error(rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard error of the mean of each column; neighbours may be alike.

    se^2 = var s / (m - s),   s of :func:`alike`
    """
    m = rest.shape[0]
    if m < 3:
        return np.full(rest.shape[1], math.inf)
    count = alike(rest)
    return np.asarray(np.sqrt(rest.var(axis=0) * count / (m - count)))


def alike(rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how many neighbouring windows of each column know no more than one.

        s = 1 + 2 sum_k rho_k

    The sum of the autocorrelation ends where two neighbours of it are no longer positive together
    (Geyer, Statistical Science 7 (1992) 473-483), and s is at most a third of the windows.
    """
    m = rest.shape[0]
    centred = rest - rest.mean(axis=0)
    size = 1 << (2 * m - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    rho = np.fft.irfft(spectrum, size, axis=0)[: m // 2 + 1]
    power = np.maximum((centred**2).sum(axis=0), 1e-300)
    pairs = rho[: rho.shape[0] // 2 * 2].reshape(-1, 2, rest.shape[1]).sum(axis=1) / power
    known = np.cumprod(pairs > 0.0, axis=0)  # up to the first that is not
    return np.asarray(np.clip(2.0 * (pairs * known).sum(axis=0) - 1.0, 1.0, m / 3.0))


def stays(
    judged: Judged, windows: int, length: float, guide: Sequence[int], target: float,
    seen: Sequence[float], least: int, most: int,
) -> bool:  # fmt: skip
    """Return whether theta should stay where it is.

    Parameters
    ----------
    judged : Judged
        What the windows say.
    windows : int
        How many there were.
    length : float
        Of one [s].
    guide : sequence of int
        Features that count.
    target : float
        Standard error that is good enough.
    seen : sequence of float
        Times that the rig needed to settle before [s].
    least, most : int
        Windows before which theta does not go on, and after which it does anyhow.
    """
    if windows >= most:
        return False
    needed = max(least, LONGER * float(np.quantile(seen, 0.75)) / length if seen else 0)
    small = bool((judged.error[list(guide)] <= target).all())
    return windows < min(needed, most) or not judged.settled or not small


def static_map(visits: Sequence[Visit], feature: int, count: int = LEVELS) -> list[Point | None]:
    """Return the map of one feature; None where theta was not."""
    found: list[Point | None] = []
    for level in range(count):
        own = [visit for visit in visits if visit.level == level]
        if not own:
            found.append(None)
            continue
        mean = np.array([visit.mean[feature] for visit in own])
        error = np.maximum([visit.error[feature] for visit in own], 1e-9)
        # few windows may happen to agree: no visit is believed much more than the usual one
        square = np.minimum(error, 1e3) ** 2
        weight = 1.0 / (square + np.median(square))
        weight /= weight.sum()
        centre = float(weight @ mean)
        inner = math.sqrt(float(weight**2 @ square))
        between = float(mean.std(ddof=1)) / math.sqrt(mean.size) if mean.size > 1 else 0.0
        found.append(Point(centre, max(inner, between), len(own)))
    return found


def clearest(visits: Sequence[Visit], candidates: Sequence[int], count: int = LEVELS) -> int:
    """Return the feature whose map stands out most from its error."""

    def worth(feature: int) -> float:
        points = [p for p in static_map(visits, feature, count) if p is not None]
        if len(points) < 2:
            return 0.0
        errors = np.array([p.error for p in points])
        return float(np.var([p.mean for p in points]) / (np.median(errors**2) + 1e-12))

    return max(candidates, key=worth)


def target_error(points: Sequence[Point | None]) -> float:
    """Return the standard error at which a map is known well enough."""
    means = [p.mean for p in points if p is not None]
    return max(FLOOR, SHARE * (max(means) - min(means))) if means else FLOOR


def unknown(visits: Sequence[Visit], feature: int, count: int = LEVELS) -> list[int]:
    """Return the values at which the map is not known well enough, and may be some day."""
    points = static_map(visits, feature, count)
    target = target_error(points)
    return [
        level
        for level, p in enumerate(points)
        if p is None or (p.visits < MOST_VISITS and (p.visits < 2 or p.error > target))
    ]


def unknown_twice(visits: Sequence[Visit], count: int = LEVELS) -> bool:
    """Return whether theta was at some value less than twice; the turning point needs one."""
    stays = [sum(visit.level == level for visit in visits) for level in range(count)]
    return sum(stay < 2 for stay in stays) > 1 or 0 in stays


def passes(up_first: bool, count: int = LEVELS) -> list[int]:
    """Return the staircase: up and down, or down and up."""
    up = list(range(count))
    return [*up, *up[-2::-1]] if up_first else [*up[::-1], *up[1:]]


def in_doubt(visits: Sequence[Visit], feature: int, sense: float, count: int = LEVELS) -> list[int]:
    """Return the values that leave open whether there is an optimum; see :mod:`valley`."""
    points = [p for p in static_map(visits, feature, count) if p is not None]
    if len(points) < count:
        return []
    means = sense * np.array([p.mean for p in points])
    errors = np.array([max(p.error, LEAST_ERROR) for p in points])
    doubtful = optimum_test.in_doubt(means, np.where(np.isfinite(errors), errors, 1e3))
    return [level for level in doubtful if points[level].visits < MOST_IN_DOUBT]


def between(
    visits: Sequence[Visit], feature: int, sense: float, at: Sequence[float]
) -> list[tuple[int, float]]:
    """Return where the map is too steep beside its best value for what lies between to be known.

    An optimum beside a cliff is found so: what is between is halved until the cliff is known.

    Parameters
    ----------
    visits : sequence of Visit
        All of them.
    feature : int
        That tells theta best.
    sense : float
        +1 where little is wanted.
    at : sequence of float
        Positions in theta's range of its values, 0 to 1, rising.

    Returns
    -------
    list of (int, float)
        Number of the value above each new one, and the new one's position; the upper one first.
    """
    points = [p for p in static_map(visits, feature, len(at)) if p is not None]
    if len(points) < len(at):
        return []
    best = min(range(len(at)), key=lambda i: sense * points[i].mean)
    found = []
    for above in (best + 1, best):
        if 0 < above < len(at) and at[above] - at[above - 1] > FINEST:
            low, high = points[above - 1], points[above]
            steep = abs(high.mean - low.mean)
            if steep > max(math.log(CLIFF), CLIFF_ERRORS * math.hypot(low.error, high.error)):
                found.append((above, 0.5 * (at[above - 1] + at[above])))
    return found[: LEVELS + ADDED - len(at)]


def next_round(
    visits: Sequence[Visit], feature: int, seed: int, sense: float, count: int = LEVELS
) -> list[int]:
    """Return the values for another round, at random; empty if the map is known well enough.

    The first round has all of them. ``sense`` is +1 where little is wanted.
    """
    first = len(visits) <= len(passes(True))
    wanted = list(range(count)) if first else unknown(visits, feature, count)
    if not first:
        wanted = sorted({*wanted, *in_doubt(visits, feature, sense, count)})
    if count > LEVELS:  # there is a cliff: what is beyond need not be known well
        points = static_map(visits, feature, count)
        means = [math.inf if p is None else sense * p.mean for p in points]
        wanted = [
            level
            for level in wanted
            if points[level] is None
            or sum(visit.level == level for visit in visits) < 2
            or means[level] - min(means) < math.log(CLIFF)
        ]
    random.Random(f"{seed} {len(visits)}").shuffle(wanted)
    if visits and len(wanted) > 1 and wanted[0] == visits[-1].level:
        wanted.append(wanted.pop(0))
    if len(wanted) == 1 and visits and wanted[0] == visits[-1].level:  # a visit is an arrival
        wanted.insert(0, wanted[0] + (1 if wanted[0] + 1 < count else -1))
    return wanted


def beside_cliff(
    visits: Sequence[Visit], feature: int, sense: float, level: int, count: int
) -> bool:
    """Return whether a value is beside a cliff next to the best one.

    An oscillation that begins there grows slowly, or waits for a gust.
    """
    points = static_map(visits, feature, count)
    known = {i: sense * p.mean for i, p in enumerate(points) if p is not None}
    if count == LEVELS or not known:
        return False
    best = min(known, key=lambda i: known[i])
    if level in known and known[level] - known[best] > math.log(CLIFF):
        return False  # it has shown
    near = [known[i] for i in (level - 1, level, level + 1) if i in known]
    return abs(level - best) <= 2 and max(near) - min(near) > math.log(CLIFF)


def from_both_sides(added: Sequence[int]) -> list[int]:
    """Return the way to values that were added, from above and from below.

    What a rig does beside a cliff may depend on where it comes from.

    >>> from_both_sides([5])
    [6, 5, 4, 5]
    """
    return [level for own in added for level in (own + 1, own, own - 1, own)]
