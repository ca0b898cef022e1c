"""A hold of theta: when the rig has settled, its level and the error.

What comes before the rig has settled is left out: the d windows for which the marginal standard
error of the rest is least (White, Simulation 69 (1997) 323-334),

    d = argmin_{d <= m/2} var(a_d .. a_m) / (m - d)

and as long as d is at that end, the rig is still settling.

Where theta came from a quiet place, a hold looks settled before an oscillation has grown:
:func:`find_proven` tells which holds were long enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged
from koop_tune.excitation.amplitude import Amplitude, Windows, bridge_gaps, find_step
from koop_tune.origin import studied

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HoldSettings(Settings):
    """When the rig has settled: how far both halves of the windows that count may differ."""

    errors: float = judged(2.5, "standard errors of the level", low=0.0)
    slight: float = judged(0.01, "change of a log amplitude, if more", low=0.0)
    usual: float = judged(0.75, "quantile of the wander that most holds show", low=0.0, high=1.0)
    grown: float = studied(0.5, "rise of a log amplitude that is a growth", low=0.0)
    far: float = judged(3.0, "amplitude over the best beyond which nothing is quiet", low=1.0)


HOLDS = HoldSettings()


class Hold:
    """Theta at one position.

    Parameters
    ----------
    u : float
        The position, 0 to 1.
    side : int
        1 if theta came from below, -1 from above.
    x : ndarray, shape (M, n)
        Samples since theta arrived.
    number : int
        Number of the hold, in order; -1 where it is not known.
    why : str
        Why theta is there.
    began : float
        When theta arrived [s]; NaN where it is not known.

    Attributes
    ----------
    size : int
        Number of samples.
    """

    def __init__(
        self,
        u: float,
        side: int,
        x: Array,
        number: int = -1,
        why: str = "",
        began: float = math.nan,
    ) -> None:
        self.u, self.side, self.number, self.why, self.began = u, side, number, why, began
        self.size = x.shape[0]
        self.confirms = False
        self._parts = [x]
        self._known: tuple[Windows, Array] | None = None
        self._level: tuple[Amplitude, int, Level] | None = None
        self._steps: tuple[int, Array, Array] | None = None

    @property
    def x(self) -> Array:
        """Samples, shape (M, n)."""
        if len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        return self._parts[0]

    def append(self, x: Array) -> None:
        """Add samples; whole windows of the same length as before are looked at alone."""
        whole = self.size % self._known[0].length == 0 if self._known else False
        self._parts.append(x)
        self.size += x.shape[0]
        if self._known is not None:
            windows, powers = self._known
            if not whole or x.shape[0] != windows.length:
                self._known = None
            else:  # the last one reached as far as there were samples
                last = windows.powers(self.x[-3 * windows.length :])[-2:]
                self._known = windows, np.concatenate([powers[:-1], last])

    def steps(self) -> tuple[Array, Array]:
        """Return the step of each channel's sensor and its standard deviation, shapes (n,)."""
        if self._steps is None or self._steps[0] != self.size:
            self._steps = self.size, find_step(self.x), bridge_gaps(self.x).std(axis=0)
        return self._steps[1:]

    def powers(self, windows: Windows) -> Array:
        """Return the powers of its windows, shape (W, n, G)."""
        if self._known is None or self._known[0] != windows:
            self._known = windows, windows.powers(self.x)
        return self._known[1]

    def late(self, windows: Windows) -> Array:
        """Return the powers of the second half, once it had settled in all likelihood."""
        powers = self.powers(windows)
        return powers[powers.shape[0] // 2 :]

    def level(self, amplitude: Amplitude, wander: float = 0.0) -> Level:
        """Return its level; ``wander`` is what other holds showed of it: a short one sees less."""
        if self._level is None or self._level[0] is not amplitude or self._level[1] != self.size:
            squares = amplitude.squares(self.powers(amplitude.windows))
            self._level = amplitude, self.size, find_level(amplitude, squares)
        return self._level[2].at_least(wander)


@dataclass(frozen=True)
class Level:
    """Level of a hold.

    Attributes
    ----------
    mean, error : float
        Logarithm of the amplitude, and its standard error.
    skip, count : int
        Windows in which the rig settled, and all.
    rise : float
        Logarithm of the level over the first window: above 0 where the oscillation grew.
    trend : float
        The same of the second half of the windows that count over the first half.
    """

    mean: float
    error: float
    skip: int
    count: int
    rise: float
    trend: float

    @property
    def wander(self) -> float:
        """error^2 times the windows that count: larger, the slower the amplitude wanders."""
        return self.error**2 * (self.count - self.skip)

    def is_settled(self, slight: float = 0.0) -> bool:
        """Return whether the rig has settled, or changes less than a slight log amplitude."""
        if abs(self.trend) < slight:
            return True
        change = max(HOLDS.errors * self.error, HOLDS.slight)
        return self.skip < self.count // 2 and abs(self.trend) < change

    def at_least(self, wander: float) -> Level:
        """Return the level with an error that such a wander explains."""
        return replace(self, error=math.sqrt(max(self.wander, wander) / (self.count - self.skip)))


def spell_error(error: float) -> str:
    """Return the standard error of a log amplitude in words.

    >>> spell_error(0.021), spell_error(2.0)
    ('2.1 %', 'unknown')
    """
    return f"{100.0 * error:.2g} %" if error < 1.0 else "unknown"


def find_level(amplitude: Amplitude, squares: Array) -> Level:
    """Return the level of the windows of one hold.

    Parameters
    ----------
    amplitude : Amplitude
        What is summed.
    squares : ndarray, shape (W,)
        A^2 in each window; W at least 2.
    """
    logs = amplitude.log(squares)
    most = squares.size // 2
    skip = int(np.argmin(_marginal_error(logs, most)))
    mean, error = mean_level(squares[skip:], amplitude.floor)
    half = squares.size - (squares.size - skip) // 2
    late, early = (
        log_of_mean(part, amplitude.floor) for part in (squares[half:], squares[skip:half])
    )
    return Level(mean, error, skip, squares.size, mean - float(logs[0]), late - early)


def _marginal_error(values: Array, most: int) -> Array:
    """Return var(a_d .. a_m) / (m - d) for d up to ``most``."""
    backwards = values[::-1] - values.mean()
    count = np.arange(1, values.size + 1)
    mean = np.cumsum(backwards) / count
    variance = np.maximum(np.cumsum(backwards**2) / count - mean**2, 0.0)
    return np.asarray((variance / count)[::-1][: most + 1])


def mean_level(squares: Array, floor: float = 0.0) -> tuple[float, float]:
    """Return the logarithm of the root of the mean, not below ``floor``, and its standard error.

    The mean of the logarithm would be lower the more an amplitude comes and goes in a window, and
    less sure: by a third for the one of a noise-driven oscillation.
    """
    mean = max(float(squares.mean()), floor**2)
    error = 0.5 * float(standard_error(squares[:, None])[0]) / mean
    return log_of_mean(squares, floor), error


def log_of_mean(squares: Array, floor: float) -> float:
    """Return the logarithm of the root of the mean, not below ``floor``."""
    return 0.5 * math.log(max(float(squares.mean()), floor**2))


def longest_growth(levels: Sequence[Level], sense: float) -> int:
    """Return the most windows in which a level was seen to become worse."""
    return max((x.skip for x in levels if sense * x.rise > HOLDS.grown), default=0)


def find_proven(u: Array, levels: Sequence[Level], sense: float) -> NDArray[np.bool_]:
    """Return which holds, in the order of time, tell what the rig comes to where they are.

    A rig that was quiet before is quiet for a while wherever theta goes: near the edge of a valley
    an oscillation grows slowly. That it stays quiet is shown by a hold as long as the longest
    growth that was seen, or by one in which it became quiet; and between two of these by any. Of
    others that began quiet and are, nothing is known where it is far worse further out.

    Parameters
    ----------
    u : ndarray, shape (N,)
        Their positions.
    levels : sequence of Level
        Their levels.
    sense : float
        +1 if little is wanted, else -1.
    """
    far = math.log(HOLDS.far)
    y, count = np.array([(sense * x.mean, x.count) for x in levels]).reshape(-1, 2).T
    before = np.r_[math.inf, y[:-1]]
    sure = (before - y > far) | (count >= longest_growth(levels, sense))
    quiet = float(y[sure].min(initial=math.inf)) + far
    places = u[sure & (y <= quiet)]
    low, high = places.min(initial=math.inf), places.max(initial=-math.inf)
    sides = [u <= v if v < low else u >= v for v in u]
    room = np.array([y[side].max() for side in sides]) - y
    doubted = (np.maximum(before, y) <= quiet) & ((u < low) | (u > high)) & (room > far)
    return np.asarray(sure | ~doubted)


def usual_wander(values: Sequence[float]) -> float:
    """Return how slowly an amplitude comes and goes, as most holds show it."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.quantile(finite, HOLDS.usual)) if finite else 0.0


def standard_error(values: Array) -> Array:
    """Return the standard error of the mean of each column; neighbours may be alike.

    se^2 = var s / (m - s),   s of :func:`count_alike`
    """
    m = values.shape[0]
    if m < 3:
        return np.full(values.shape[1], math.inf)
    count = count_alike(values)
    return np.asarray(np.sqrt(values.var(axis=0) * count / (m - count)))


def count_alike(values: Array) -> Array:
    """Return how many neighbouring windows of each column know no more than one.

        s = 1 + 2 sum_k rho_k

    The sum of the autocorrelation ends where two neighbours of it are no longer positive together
    (Geyer, Statistical Science 7 (1992) 473-483), and s is at most a third of the windows.
    """
    m = values.shape[0]
    centred = values - values.mean(axis=0)
    size = 1 << (2 * m - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    rho = np.fft.irfft(spectrum, size, axis=0)[: m // 2 + 1]
    power = np.maximum((centred**2).sum(axis=0), 1e-300)
    pairs = rho[: rho.shape[0] // 2 * 2].reshape(-1, 2, values.shape[1]).sum(axis=1) / power
    positive = np.cumprod(pairs > 0.0, axis=0)  # up to the first that is not
    return np.asarray(np.clip(2.0 * (pairs * positive).sum(axis=0) - 1.0, 1.0, m / 3.0))
