"""Whether the rig is no longer the one it was: the frequency of its oscillation has moved.

First the oscillation is looked for (:func:`koopman_lifter.delays.dominant_period`) in a few
thousand samples, or in means of 2, 4, ... samples until it is slow enough for them. That gives f0.
Where tuning has told about where it is, f0 is the strongest line there: the strongest of all may be
interference, which theta does not change.

From then on four segments of two periods each are a window. The window's spectrum at the bins
around f0, combined as a Blackman window, is the complex amplitude C of a channel: interference 40 %
away is 58 dB down. From one window to the next, two periods later, its phase advances by

    arg P = 4 pi e,     e = f / f0 - 1,     P = sum over channels of conj(C) C' / usual variance,

which gives f within a quarter of f0, whatever the amplitude: what a controller does to that is no
change. For samples that are lost, up to a period of them, the mean stands. The running mean of e
over the first windows gives the known range [low, high], which holds what f owes to theta. Then a
cumulative sum (CUSUM; Page 1954) for either side adds up the logarithm of the likelihood that e is
``move`` beyond the range to that of its being at the end of it,

    S' = max(0, S + w (move / s^2) (beyond - move / 2)),

and S > ln(windows of a day) is a change: from independent windows of the range it takes a day at
least on average until the next (Lorden 1971). s^2 is the variance of e about its running mean, w
the power of a window over the usual one, at most 1 as noise moves the phase of a weak oscillation
more, times what overlapping windows leave of new information.

A frequency that has left that quarter tells the phases nothing. So spectra of what is listened to
go on, each of some hundred periods: a change is also a line away from the known range of ten times
the power that was ever there, before the last spectrum, and of ten times what is left within the
range. If that is as much as half of what the last spectrum had there, the oscillation has stayed:
the line is interference. Where the phases tell that it has left, it is the line that rose most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_core.kernels import direct, njit
from koopman_lifter.delays import dominant_period, units, window_powers
from koopman_lifter.settings import COST, WATCH

SEGMENTS = 4  # of a window, two periods each: their phases are quarters of a turn
BLACKMAN = (0.04, -0.25, 0.42, -0.25, 0.04)  # of the bins 6 to 10 of a window: the 8th is at f0
FIRST_BIN = 6
QUARTERS = (1.0 + 0.0j, -1.0j, -1.0 + 0.0j, 1.0j)  # exp(-i phase) after quarters of a turn
DAY = 86400.0  # [s]
BLOCK = 16  # states that are looked at together: the call costs more than that
LOOKED = 20  # windows that dominant_period makes of what is listened to
GAP = 32  # such a share of what is listened to may be lost at once, else it begins anew
FITS = 4  # periods in one of them, at least
AVERAGED = 4  # windows of a spectrum of what is listened to: 20 periods in each, at least
TOLD = 0.15  # e that is told: a frequency that has left the quarter looks like a larger one
LEFT = 0.2  # of f0: a line farther away from the known range is no longer that of f0
LEAKED = 2  # bins on either side of a line, and those of a trend
LARGEST = 1e150  # of a measured value, whose square is finite
FAINT = 1e-6  # of the largest power of a spectrum: no line that has appeared
TINY = float(np.finfo(float).tiny)


class Spectrum(NamedTuple):
    """Arrays that the kernel writes to."""

    sums: NDArray[np.complex128]
    """Shape (SEGMENTS, n, 5): spectra of the last segments, by age; the first one is being
    filled."""
    moments: NDArray[np.float64]
    """Shape (SEGMENTS, n, 2): sums of their samples and of the squares."""
    turn: NDArray[np.complex128]
    """Shape (2, 5): exp(-i phase) of the next sample, and of one sample."""
    amplitude: NDArray[np.complex128]
    """Shape (n,): C of the last window."""
    usual: NDArray[np.float64]
    """Shape (n,): running mean of the sum of squares of a window about its mean."""
    last: NDArray[np.float64]
    """Shape (n,): the last sample."""
    cursor: NDArray[np.int64]
    """Shape (5,): samples in the first segment and in a whole one; segments and windows without a
    gap; step of the last sample; windows."""


class Side(NamedTuple):
    """S of one side, and the mean of e since it was 0, a window the weight of all before it."""

    s: float = 0.0
    e: float = 0.0


class Tally(NamedTuple):
    """What the windows so far say."""

    above: Side = Side()
    below: Side = Side()
    """Cumulative sums."""
    low: float = math.inf
    high: float = -math.inf
    """Known range of e."""
    mean: float = 0.0
    variance: float = WATCH.move**2
    power: float = 0.0
    """Running means of e, of its squared deviation, and of |P|."""
    windows: int = 0
    """How many."""


def spectrum(segment: int, channels: int) -> Spectrum:
    """Return what the windows begin with; ``segment`` is the number of samples of two periods."""
    bins = FIRST_BIN + np.arange(len(BLACKMAN))
    turn = np.exp(-2j * math.pi * bins / (SEGMENTS * segment))
    return Spectrum(
        np.zeros((SEGMENTS, channels, bins.size), np.complex128),
        np.zeros((SEGMENTS, channels, 2)),
        np.stack([np.ones(bins.size, np.complex128), turn]),
        np.zeros(channels, np.complex128),
        np.zeros(channels),
        np.zeros(channels),
        np.array([0, segment, 0, 0, 0]),
    )


@njit()
def _begin_segment(s: Spectrum) -> None:
    s.cursor[0] = 0
    s.sums[0] = 0.0
    s.moments[0] = 0.0
    s.turn[0] = 1.0


@njit()
def _add(s: Spectrum, x: NDArray[np.float64]) -> complex:
    """Add a sample; return P where it completes the second or a later window, else 0."""
    sums, moments, turn, cursor = s.sums, s.moments, s.turn, s.cursor
    for i in range(x.shape[0]):
        moments[0, i, 0] += x[i]
        moments[0, i, 1] += x[i] * x[i]
        for m in range(turn.shape[1]):
            sums[0, i, m] += x[i] * turn[0, m]
    for m in range(turn.shape[1]):
        turn[0, m] *= turn[1, m]
    cursor[0] += 1
    if cursor[0] < cursor[1]:
        return 0j
    cursor[2] = min(cursor[2] + 1, SEGMENTS + 1)
    product = 0j
    cursor[4] += cursor[2] >= SEGMENTS
    for i in range(x.shape[0] if cursor[2] >= SEGMENTS else 0):
        c, total, squares = 0j, 0.0, 0.0
        for age in range(SEGMENTS):
            total += moments[age, i, 0]  # NumPy's sum would import SciPy at a node's start
            squares += moments[age, i, 1]
            for m in range(turn.shape[1]):
                quarters = (FIRST_BIN + m) * (SEGMENTS - 1 - age) % 4  # since the oldest
                c += BLACKMAN[m] * QUARTERS[quarters] * sums[age, i, m]
        variance = squares - total * total / (SEGMENTS * cursor[1])
        if cursor[4] > 1:
            variance = min(variance, WATCH.spike * s.usual[i])
        s.usual[i] += (variance - s.usual[i]) / min(cursor[4], WATCH.memory)
        if cursor[2] > SEGMENTS and s.usual[i] > 0.0:
            product += s.amplitude[i].conjugate() * c / s.usual[i]
        s.amplitude[i] = c
    for age in range(SEGMENTS - 1, 0, -1):
        for i in range(x.shape[0]):
            moments[age, i, 0], moments[age, i, 1] = moments[age - 1, i, 0], moments[age - 1, i, 1]
            for m in range(turn.shape[1]):
                sums[age, i, m] = sums[age - 1, i, m]
    _begin_segment(s)
    return product


@njit()
def _side(side: Side, gain: float, e: float) -> Side:
    s = side.s + gain
    if s <= 0.0:
        return Side(0.0, 0.0)
    return Side(s, e if side.s == 0.0 else 0.5 * (side.e + e))


@njit()
def _count(threshold: float, t: Tally, product: complex) -> Tally:
    """Take a window."""
    n, e = t.windows + 1, math.atan2(product.imag, product.real) / (4.0 * math.pi)
    power = abs(product) if n == 1 else min(abs(product), WATCH.spike * t.power)
    usual = t.power + (power - t.power) / min(n, WATCH.memory)
    w = min(abs(product) / usual, 1.0) if usual > 0.0 else 0.0
    away = e - t.mean
    mean = t.mean + w * away / min(n, WATCH.averaged)
    variance = t.variance
    if n > 1:
        variance += (w * away * away - variance) / min(n, WATCH.memory)
    above, below, low, high = t.above, t.below, t.low, t.high
    if n > WATCH.known:
        slope = WATCH.new * w * WATCH.move / max(t.variance, WATCH.least**2)
        most, allowed = WATCH.most * threshold, 0.5 * WATCH.move
        above = _side(above, min(slope * (e - high - allowed), most), e)
        below = _side(below, min(slope * (low - e - allowed), most), e)
    elif n >= WATCH.averaged:
        low, high = min(low, mean), max(high, mean)
    return Tally(above, below, low, high, mean, variance, usual, n)


@njit()
def follow(threshold: float, s: Spectrum, tally: Tally, step: int, x: NDArray[np.float64]) -> Tally:
    """Take a measured state, shape (n,).

    One or two lost ones are as the one before, those of up to a period as the mean.
    """
    for i in range(x.shape[0]):
        if not abs(x[i]) < LARGEST:
            return tally
    lost = step - s.cursor[3] - 1
    if lost < 0 or lost > s.cursor[1] // 2:
        s.cursor[2] = lost = 0
        _begin_segment(s)
    for i in range(x.shape[0] if lost > COST.bridged else 0):
        s.last[i] = s.moments[1, i, 0] / s.cursor[1]
    for i in range(lost + 1):
        product = _add(s, x if i == lost else s.last)
        if product != 0j:
            tally = _count(threshold, tally, product)
    for i in range(x.shape[0]):  # assigning arrays takes seconds to compile
        s.last[i] = x[i]
    s.cursor[3] = step
    return tally


class Listening(NamedTuple):
    """Samples in which an oscillation is looked for."""

    rows: NDArray[np.float64]
    """Shape (M, n): means of ``every`` samples."""
    part: NDArray[np.float64]
    """Shape (n,): sum of the samples of the next mean."""
    mean: NDArray[np.float64]
    """Shape (n,): mean of the rows; it stands for lost samples."""
    cursor: NDArray[np.int64]
    """Shape (4,): rows filled, ``every``, samples in ``part``, step of the last sample."""


class Senses(NamedTuple):
    """What a watch hears with."""

    ear: Listening
    """Samples in which the oscillation is looked for."""
    threshold: float
    """S that is a change; infinite while the oscillation is not found."""
    spectrum: Spectrum
    """Of the windows, once it is."""


@njit()
def listen(ear: Listening, step: int, x: NDArray[np.float64]) -> None:
    """Take a measured state, shape (n,), the mean for few lost ones; what is full takes no more."""
    cursor, rows = ear.cursor, ear.rows
    for i in range(x.shape[0]):
        if not abs(x[i]) < LARGEST:
            return
    lost = step - cursor[3] - 1
    cursor[3] = step
    if lost < 0 or lost * GAP > rows.shape[0] * cursor[1]:
        cursor[0] = cursor[2] = 0
    if cursor[0] == 0:
        lost = 0
    for k in range(lost + 1):
        if cursor[0] == rows.shape[0]:
            return
        for i in range(x.shape[0]):
            value = x[i] if k == lost else ear.mean[i]
            ear.part[i] = (ear.part[i] if cursor[2] > 0 else 0.0) + value
        cursor[2] += 1
        if cursor[2] == cursor[1]:
            for i in range(x.shape[0]):
                rows[cursor[0], i] = ear.part[i] / cursor[1]
                ear.mean[i] += (rows[cursor[0], i] - ear.mean[i]) / (cursor[0] + 1)
            cursor[0] += 1
            cursor[2] = 0


@njit()
def hear(senses: Senses, tally: Tally, step: int, x: NDArray[np.float64]) -> Tally:
    """Take a measured state, shape (n,); return the tally after it."""
    listen(senses.ear, step, x)
    if senses.threshold < math.inf:
        return follow(senses.threshold, senses.spectrum, tally, step, x)
    return tally


@njit()
def hear_all(
    senses: Senses, tally: Tally, steps: NDArray[np.int64], states: NDArray[np.float64]
) -> Tally:
    """Take measured states, shape (M, n), of so many steps; return the tally after them."""
    for i in range(steps.shape[0]):
        tally = hear(senses, tally, steps[i], states[i])
    return tally


@dataclass(frozen=True)
class Change:
    """A mode that has moved: from and to [Hz]; NaN: too far for its phases to tell.

    Or interference at the second frequency, which now outshines a mode that stays at the first.
    """

    before: float
    after: float
    interference: bool = False

    def __str__(self) -> str:
        if self.interference:
            return (
                f"what oscillates at {self.after:.4g} Hz outshines the oscillation at "
                f"{self.before:.4g} Hz that is watched: interference, or what theta changes"
            )
        to = f"to {self.after:.4g} Hz"
        if math.isnan(self.after):
            to = f"Hz by more than {100.0 * TOLD:g} %"
        return f"the rig has changed: its oscillation moved from {self.before:.4g} {to}"


class Watch:
    """The watch of a run; after a change it learns again what is known.

    ``channels`` is the number of measured values, ``dt`` the sampling time [s], ``near`` about
    the frequency of the oscillation [Hz]; 0: the one whose power varies most. ``senses`` is what
    :func:`hear` needs; who calls that sets ``tally``.
    """

    def __init__(self, channels: int, dt: float, near: float = 0.0) -> None:
        self.channels, self._dt = channels, dt
        self._steps, self._states = np.zeros(BLOCK, np.int64), np.zeros((BLOCK, channels))
        self._begin(near)
        self._hear = direct(hear_all, self.senses, Tally(), self._steps[:0], self._states)

    def _begin(self, near: float = 0.0) -> None:
        """Forget what is known, and look for the oscillation."""
        n, self._near, self._lost = self.channels, near, 0.0
        rows, cursor = np.zeros((WATCH.listened, n)), np.array([0, 1, 0, 0])
        ear = Listening(rows, np.zeros(n), np.zeros(n), cursor)
        self.senses, self.tally, self._count = Senses(ear, math.inf, spectrum(9, n)), Tally(), 0
        self._last: NDArray[np.float64] = np.zeros(0)  # power by bin of the last spectrum
        self._most: NDArray[np.float64] = np.zeros(0)  # the most of all before it
        self._scale: NDArray[np.float64] = np.ones(n)

    @property
    def frequency(self) -> float | None:
        """Mean frequency of the last windows [Hz]; None while the oscillation is looked for."""
        return self._hertz(self.tally.mean) if self.senses.threshold < math.inf else None

    @property
    def learned(self) -> bool:
        """Whether the known range is learned."""
        return self.tally.windows >= WATCH.known

    def take(self, step: int, x: NDArray[np.float64]) -> Change | None:
        """Take a measured state, shape (n,); a block of them is looked at at once."""
        i = self._count
        self._steps[i], self._states[i] = step, x
        self._count = i + 1
        return self.settle() if self._count == BLOCK else None

    def settle(self) -> Change | None:
        """Look at what has been taken."""
        block = self._steps[: self._count], self._states[: self._count]
        self._count = 0
        self.tally = self._hear(self.senses, self.tally, *block)
        sides = self.tally.above.s, self.tally.below.s
        return self.judge() if max(sides) > self.senses.threshold else None

    def look(self) -> Change | None:
        """Look at the spectrum where enough was heard: some milliseconds now and then."""
        rows, _, _, cursor = self.senses.ear
        if cursor[0] < len(rows):
            return None
        if self.senses.threshold < math.inf:
            return self._compare(self._power())
        if self._lost:
            return self._find_again(self._power())
        self._look_for_oscillation()
        return None

    def _find_again(self, power: NDArray[np.float64]) -> Change | None:
        """Look for an oscillation that has left its quarter where a spectrum rose most."""
        rise = self._rise(power, FAINT * power.max())
        peak, before, self._lost = int(np.argmax(rise)), self._lost, 0.0
        if rise[peak] <= WATCH.outshone:
            self._begin()
            return None
        at = self._line(power, peak)
        if at < 0.5 * before:  # too slow for this spectrum
            self._begin(at)
        else:
            self._follow_line(at)
            self._last = self._most = power
        return Change(before, at)

    def _rise(self, power: NDArray[np.float64], least: float) -> NDArray[np.float64]:
        """Return the power of each line over the most that was there, and at least so much."""
        spread = sliding_window_view(np.pad(self._most, LEAKED), 2 * LEAKED + 1).max(axis=1)
        rise = power / np.maximum(spread, max(least, TINY))
        rise[:LEAKED] = rise[-LEAKED:] = 0.0
        return rise

    def _look_for_oscillation(self) -> None:
        rows, _, _, cursor = self.senses.ear
        size = len(rows)
        dt = float(cursor[1]) * self._dt
        try:
            period = 1.0 / self._near if self._near else dominant_period([rows.T], dt)
        except InputError:  # nothing moves, or as in every window
            cursor[0] = 0
            return
        if FITS * period > size // LOOKED * dt:
            rows[: size // 2] = 0.5 * (rows[0::2] + rows[1::2])
            cursor[0], cursor[1] = size // 2, 2 * cursor[1]
            return
        frequency, self._scale = 1.0 / period, units(rows, 0)
        self._last = self._most = power = self._power()
        if self._near:
            near = np.abs(np.arange(power.size) * self._resolution / frequency - 1.0) <= LEFT
            if not power[near].any():  # nothing moves
                return
            frequency = self._line(power, int(np.argmax(power * near)))
        self._follow_line(frequency)

    def _follow_line(self, frequency: float) -> None:
        """Learn what is known of an oscillation of a frequency [Hz]."""
        segment = max(round(2.0 / (frequency * self._dt)), 1)
        threshold = math.log(max(DAY / (segment * self._dt), 10.0))
        self.senses = Senses(self.senses.ear, threshold, spectrum(segment, self.channels))
        self.tally = Tally()

    def _power(self) -> NDArray[np.float64]:
        """Return the power by bin of what was listened to, and listen again."""
        rows, _, _, cursor = self.senses.ear
        cursor[0] = 0
        return window_powers((rows / self._scale).T, len(rows) // AVERAGED).sum(axis=1)

    def _compare(self, power: NDArray[np.float64]) -> Change | None:
        """Compare a spectrum with those before it; return a jump of the oscillation."""
        t = self.tally
        if self.learned:
            low, high = self._hertz(t.low), self._hertz(t.high)
            own = 0.5 * (low + high)
            hertz = np.arange(power.size) * self._resolution
            away = np.maximum(low - hertz, hertz - high) / own
            left = power[away <= 0.5 * LEFT].max(initial=TINY)
            rise = np.where(away > LEFT, self._rise(power, left), 0.0)
            peak = int(np.argmax(rise))
            if rise[peak] > WATCH.outshone:
                at = self._line(power, peak)
                if left >= WATCH.stayed * self._last[away <= 0.5 * LEFT].max(initial=TINY):
                    self._most = np.maximum(self._most, power)
                    return Change(own, at, interference=True)
                self._begin(at)
                return Change(own, at)
        known = np.minimum(self._last, WATCH.bang * self._most)
        self._most, self._last = np.maximum(WATCH.kept * self._most, known), power
        return None

    @property
    def _resolution(self) -> float:
        """Distance of two bins of a spectrum of what is listened to [Hz]."""
        rows, _, _, cursor = self.senses.ear
        return AVERAGED / (len(rows) * float(cursor[1]) * self._dt)

    def _line(self, power: NDArray[np.float64], peak: int) -> float:
        """Return the frequency of a line [Hz] from the bin of its peak."""
        line = slice(peak - LEAKED, peak + LEAKED + 1)
        bins = np.arange(power.size)[line]
        return float(np.average(bins, weights=power[line])) * self._resolution

    def judge(self) -> Change:
        """Return the change that the phases show, and learn again what is known.

        A line that they tell is followed on: what is listened to may hold stronger ones by now.
        """
        t = self.tally
        after, end = (t.above.e, t.high) if t.above.s > t.below.s else (t.below.e, t.low)
        change = Change(self._hertz(end), self._hertz(after if abs(after) <= TOLD else math.nan))
        if math.isnan(change.after):
            self.senses, self._lost = self.senses._replace(threshold=math.inf), change.before
            self.senses.ear.cursor[0] = 0
        else:
            self._follow_line(change.after)
        return change

    def _hertz(self, e: float) -> float:
        return float(2.0 * (1.0 + e) / (self.senses.spectrum.cursor[1] * self._dt))
