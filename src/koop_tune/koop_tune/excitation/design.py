"""What an excitation decides: where theta goes next, how long it is held, when enough is known.

A few positions come first, both ends among them, up and down. Then a Gaussian process on the holds'
log amplitudes (:mod:`koop_tune.excitation.static_map`) says where a hold tells most:

1. where the least amplitude may be: the largest expected improvement (Jones, Schonlau and Welch,
   Journal of Global Optimization 13 (1998) 455-492);
2. at an end of the range that may be as good as the best;
3. where the valley ends: the largest  1.96 s(u) - |y(u) - bound|  (Bryan et al., NIPS 2005);
4. at the best again, from either side, for as long as an oscillation was seen to need to grow.

:class:`Design` is told what the rig said, window by window, and says what is next; who moves theta
and who listens is another's, be it ``koop excite`` with a rig or a study with a simulated one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged, parameter
from koop_core.errors import InputError
from koop_tune.excitation.amplitude import (
    AMPLITUDE,
    Amplitude,
    Windows,
    choose_amplitude,
    find_hidden,
    whole_amplitude,
    window_length,
)
from koop_tune.excitation.channels import find_lines, should_listen
from koop_tune.excitation.holds import Hold, Level, find_proven, longest_growth, usual_wander
from koop_tune.excitation.static_map import MAP, StaticMap
from koop_tune.excitation.steady import unsteady_shares
from koop_tune.origin import studied
from koop_tune.rig.rig_file import RigFile

Array = NDArray[np.float64]
KNOWN, FLAT, TIME = "known", "flat", "time"
GAP = "a gap in which a narrow valley would hide"


@dataclass(frozen=True)
class DesignSettings(Settings):
    """When enough was heard, how long theta is held, and when the map is known."""

    window: float = studied(8.0, "window, in periods of the lowest frequency that reacts", low=4.0)
    before: float = studied(8.0, "the same of the slowest line, before that is known", low=1.0)
    clear: float = studied(1.5, "factor of the amplitude between two holds that tells", low=1.0)
    far: float = judged(30.0, "amplitude over the best whose frequencies do not count", low=1.0)
    fast: float = studied(24.0, "the same of the fastest line, if less", low=4.0)
    listen: float = studied(40.0, "periods before theta moves", low=1.0)
    shortest: float = parameter(3.0, "time of that at least", unit="s", low=0.1)
    longest: float = parameter(120.0, "time of that at most", unit="s", low=1.0)
    longest_share: float = parameter(0.02, "the same over the rig file's time, if more", low=0.0)
    first: int = studied(6, "positions on the way up; one fewer between them down", low=3)
    fewest: int = studied(6, "windows of a hold", low=4)
    lag: float = studied(0.3, "share of the slope by which levels lag", low=0.0)
    less: float = studied(0.7, "lag in holds twice as long over the one before", low=0.0, high=1.0)
    patience: float = parameter(16.0, "longest first holds, in the usual ones", low=1.0)
    brief: int = studied(4, "the same of one that only looks into a gap", low=4)
    usual: float = studied(0.75, "quantile of what holds show that the next one may need")
    reserve: float = studied(1.5, "hold, in times that the rig was seen to need", low=1.0)
    growth: float = studied(2.0, "hold at the best, in the longest growth seen", low=1.0)
    most_share: float = parameter(0.1, "longest hold, over the rig file's time", low=0.01)
    soon: float = parameter(0.02, "share of a hold after which it is judged again", low=0.0)
    error: float = studied(0.03, "standard error that is good enough", low=1e-3)
    error_of_span: float = studied(0.05, "the same over the map's span, if more", low=0.0)
    error_of_best: float = studied(0.1, "the same of the best, if less, for the verdict", low=0.0)
    error_of_worse: float = studied(0.15, "the same over what it is worse than the best, if more")
    error_of_gap: float = studied(0.1, "the same of a hold that only looks into a gap", low=0.0)
    trend: float = studied(0.3, "change within a hold that may be, over that error", low=0.0)
    often: int = studied(3, "holds at a place after which no better value is expected", low=1)
    improvement: float = studied(0.03, "expected improvement that is none", low=1e-3)
    steep: float = studied(1.3, "amplitude over the best of a neighbour that is too far", low=1.0)
    gap: float = studied(0.055, "widest gap between two holds, in ranges", low=0.0)
    rival: float = studied(3.0, "amplitude over the best of a second valley that is looked into")
    edge: float = studied(0.5, "width of the valley that may be unknown, over its own", low=0.0)
    longer: int = parameter(4, "windows if nothing, or something slower, reacts, in these", low=2)
    slower: float = judged(3.0, "standard errors by which what is slower must react", low=0.0)
    rounds: int = studied(3, "times at the first positions if nothing reacts", low=1)
    finest: float = parameter(0.004, "the same in ranges, if more", low=1e-4)
    passed: float = judged(
        2e-3, "distance of a first position from a hold before, in ranges, at which it is left out",
        low=0.0
    )  # fmt: skip
    same: float = studied(0.25, "distance of two holds at one place, over the valley", low=0.0)
    beside: float = studied(0.05, "distance of a hold from an end that is the best", low=0.0)
    ends: int = studied(5, "holds at an end that may be the best", low=1)
    most: int = parameter(48, "holds of an excitation", low=9)
    redefined: float = judged(
        0.1, "change of a reported log amplitude by a new unit that is announced", low=0.0
    )
    wider: float = judged(
        4.0, "distance of first positions over the one before, where nothing differed", low=1.1
    )
    overshoot: float = parameter(0.1, "way beyond, to come back from the other side", low=0.0)


DESIGN = DesignSettings()


class Move(NamedTuple):
    """Where theta goes: the position of the next hold, one to pass on the way, and why."""

    u: float
    via: float | None = None
    why: str = ""


class Design:
    """The decisions of an excitation.

    Parameters
    ----------
    rig : RigFile
        The rig.
    holds : list of Hold
        Done before.
    windows : Windows, optional
        How samples were cut before.
    settings : DesignSettings
        Thresholds.
    after : Design, optional
        That of another knob before: its windows and patience, and what was heard, go on.
    others : sequence of (Hold, ndarray)
        Holds elsewhere, with the position of all knobs, which count for what is summed.
    first : sequence of float, optional
        First positions, in place of those over the whole range.
    place : callable, optional
        Position of all knobs at one of this knob; it alone unless given.

    Attributes
    ----------
    rig : RigFile
        The rig; its time may be set longer.
    holds : list of Hold
        Finished.
    amplitude : Amplitude or None
        What is summed; None until something reacts.
    windows : Windows
        How samples are cut.
    since : float
        Time [s] before which holds do not count: they were too short for the rig.
    ended : str
        Why there is no next position: ``known`` or ``flat``; empty before.
    """

    def __init__(
        self,
        rig: RigFile,
        holds: Sequence[Hold] = (),
        windows: Windows | None = None,
        settings: DesignSettings = DESIGN,
        after: Design | None = None,
        others: Sequence[tuple[Hold, Array]] = (),
        first: Sequence[float] | None = None,
        place: Callable[[float], Array] | None = None,
    ) -> None:
        self.rig, self._settings, self._first, self._place = rig, settings, first, place
        self.holds, self._others = list(holds), list(others)
        self.windows: Windows = windows or (after.windows if after else Windows(64, rig.dt))
        self.amplitude: Amplitude | None = None
        self.period = math.inf
        self.ended = ""
        self.since = 0.0
        self._heard: Hold | None = after._heard if after else None
        self._hold = Hold(rig.u_start, 0, np.empty((0, len(rig.names))))
        self._growth = self._brief = self._slow = False
        self._usual, self._target, self._best = 0.0, settings.error, math.inf
        self._expected = -math.inf
        self._least = self._most = self._next = settings.fewest
        up = rig.u_start <= 0.5
        self._queue = self._missing(up)
        self._rounds, self._longest, self._elapsed = 1, 0, 0.0
        self._patience: float = after._patience if after else 1.0
        self._most_lag = 1.0
        self._check_lag = len(self._queue) == 2 * settings.first - 1
        self._choose()

    # -- before theta moves ---------------------------------------------------------------------

    def listens(self, x: Array) -> bool:
        """Return whether more must be heard than x, shape (M, n), before theta moves."""
        s = self._settings
        longest = max(s.longest, s.longest_share * self.rig.time)
        return should_listen(x, self.rig.dt, s.shortest, s.listen, longest)

    def look(self, x: Array) -> tuple[float, float]:
        """Choose the first windows from what was heard, shape (M, n).

        Returns
        -------
        tuple of float
            Periods of the fastest and the slowest line [s].

        Raises
        ------
        koop_core.errors.InputError
            If no channel moves.
        """
        dt = self.rig.dt
        lines = [line for column in x.T for line in find_lines(column, dt)]
        if not lines:
            raise InputError("no channel moves: dead sensors, or other fields")
        periods = [1.0 / line.frequency for line in lines]
        s = self._settings
        longest = min(s.before * max(periods), s.fast * min(periods))  # the slowest may not react
        length = window_length(longest, 1.0, dt)
        self.windows = Windows(min(length, max(64, x.shape[0] // 4)), dt)
        self._heard = Hold(self.rig.u_start, 0, x)
        return min(periods), max(periods)

    @property
    def needed(self) -> tuple[float, float]:
        """Time that the first positions need at least, and all that is to come [s].

        If what reacts is what was heard: then theta goes into each gap, and to the best from both
        sides.
        """
        s, hold, seconds = self._settings, self.hold_seconds, self.windows.seconds
        first = len(self._queue) * hold
        first += 2.0 * self.rig.span / self.rig.theta_rate if self._queue else 0.0
        gaps = np.diff(np.unique([*self._queue, *(hold.u for hold in self.holds)]))
        halves = 2.0 ** np.ceil(np.log2(np.maximum(gaps / s.gap, 1.0))) - 1.0
        sides = {hold.side for hold in self.holds if hold.confirms}
        best = max(2 - len(sides), not self._queue)
        return first, first + float(halves.sum()) * s.brief * seconds + best * hold

    @property
    def hold_seconds(self) -> float:
        """Time of a hold at least, as the rig was seen so far [s]."""
        return self._needed_windows() * self.windows.seconds

    # -- where theta goes -----------------------------------------------------------------------

    def next(self) -> Move | None:
        """Return where theta goes next; None once enough is known."""
        move = self._choose_move()
        if move is None:
            self.ended = self.ended or KNOWN
            return None
        if len(self.holds) >= self._settings.most:  # nothing more is learned
            known = self.amplitude is not None and not self.static_map().flat
            self.ended = KNOWN if known else TIME
            return None
        return move

    def next_first(self) -> Move | None:
        """Return where theta goes next over the range; None once it was everywhere there."""
        self._growth = self._brief = False
        if not self._queue and self._check_lag and self._lags():
            self._patience *= 2.0
            self._check_lag = True
            self._begin_again(self.windows.length)
        why = "over the range" if self._first is None else "on both sides of the best"
        return Move(self._queue[0], why=why) if self._queue else None

    def _choose_move(self) -> Move | None:
        s = self._settings
        if (move := self.next_first()) is not None:
            return move
        static_map = None if self.amplitude is None else self.static_map()
        if static_map is None:
            if self._rounds == 1 and (gap := self._gap(self.holds[-1].u)) is not None:
                return Move(gap, why=GAP)
            if self._rounds >= s.rounds:
                self.ended = FLAT
                return None
            self._rounds += 1
            self._patience *= 2.0  # noise hides less in longer holds
            return self._look_again(s.longer * self.windows.length, "nothing reacted")
        gap = self._gap(static_map.best())
        if static_map.flat:
            if gap is not None:
                return Move(gap, why=GAP)
            again, up = "again", self.holds[-1].u < 0.5
            if self._first is not None:
                again = "further out"
                middle = float(np.mean(self._first))
                wider = middle + s.wider * (np.array(self._first) - middle)
                self._first = np.unique(np.clip(wider, 0.0, 1.0)).tolist()
            self._queue = self._missing(up) or self._positions(up)
            return Move(self._queue[0], why=f"{again}: errors hide the map")
        grid = static_map.grid[::4]
        held = (np.abs(static_map.u[:, None] - grid) < s.finest).sum(axis=0)
        gain = static_map.expected_improvement(grid, self._floor)
        gain = np.where(held < s.often, gain, 0.0)
        if float(gain.max()) > self._tolerance(static_map):
            return Move(float(grid[int(np.argmax(gain))]), why="a better value may be there")
        if (between := self._bracket(static_map)) is not None:
            return Move(between, why="between the best and a neighbour that is far worse")
        if gap is not None:
            self._brief = True
            y, deviation = static_map.predict(np.array([gap]))
            self._expected = float(y[0] - 2.0 * deviation[0])
            return Move(gap, why=GAP)
        if (beside := self._beside_rival(static_map)) is not None:
            return Move(beside, why="beside a second valley, which may be deeper than was seen")
        if (end := self._doubtful_end(static_map)) is not None:
            return end._replace(why="whether an end is the best")
        if (edge := self._unknown_edge(static_map)) is not None:
            return Move(edge, why="where the valley ends")
        if (move := self._confirm(static_map)) is not None:
            return move
        if (length := self._slower(static_map)) is None:
            return None
        self._slow = True
        return self._look_again(length, "what is slower reacts too")

    def _look_again(self, length: int, why: str) -> Move | None:
        """Return where theta goes for longer windows; holds that are long enough for them stay."""
        least = round(self._patience * self._settings.fewest) * length
        self._begin_again(length, [hold for hold in self.holds if hold.size >= least])
        move = self._choose_move()
        return move and move._replace(why=f"again, with longer windows: {why}")

    def _lags(self) -> bool:
        """Return whether the rig was still on its way at the first positions: it is slow.

        On the way back the levels are then those of positions further on: they differ from the
        means of their neighbours on the way there by a share of the slope: a valley by more, or by
        as much when theta is held for longer.
        """
        self._check_lag = False
        levels = [level.mean for level in self.levels()[-(2 * self._settings.first - 1) :]]
        order = np.argsort([hold.u for hold in self.holds[-len(levels) :]])
        y = np.array(levels)[order]
        slope, beyond = y[2::2] - y[:-2:2], y[1::2] - 0.5 * (y[2::2] + y[:-2:2])
        way = 1.0 if self.holds[-len(levels) :][order[1]].side < 0 else -1.0
        squares = max(float(slope @ slope), 1e-12)
        share = float(slope @ beyond) / squares
        rest = beyond - share * slope
        error = math.sqrt(float(rest @ rest) / (rest.size - 1) / squares)
        share *= way
        lags = share - 2.0 * error > self._settings.lag and share < self._most_lag
        self._most_lag = self._settings.less * share
        return lags and self._patience < self._settings.patience

    def _begin_again(self, length: int, kept: Sequence[Hold] = ()) -> None:
        """Go to the first positions again, with windows of so many samples; some holds count."""
        up, self.holds = self.holds[-1].u < 0.5, list(kept)
        self._queue = self._missing(up)
        self.windows, self._longest = self.windows._replace(length=length), length
        if not kept:
            self.since = self._elapsed + self._hold.size * self.rig.dt
        self._choose()

    def _missing(self, up: bool) -> list[float]:
        """Return the first positions at which there is no hold."""
        held, s = np.array([hold.u for hold in self.holds]), self._settings
        return [u for u in self._positions(up) if not (np.abs(held - u) < s.passed).any()]

    def _positions(self, up: bool) -> list[float]:
        """Return the first positions."""
        return first_positions(self._settings.first, up) if self._first is None else [*self._first]

    def _slower(self, static_map: StaticMap) -> int | None:
        """Return the samples of windows in which something slower reacts than these resolve."""
        s, lowest = self._settings, self.windows.frequency[AMPLITUDE.lowest]
        slower, most = self._is_slower(static_map), static_map.least + math.log(s.far)
        levels = zip(self.holds, self.levels(), strict=True)
        near = [hold for hold, level in levels if self.rig.sense * level.mean <= most]
        for longer in (s.longer, s.longer**2):
            windows = self.windows._replace(length=longer * self.windows.length)
            if windows.length <= self._longest:
                continue  # looked at before
            if slower:
                return windows.length
            holds = [h for h in near if h.size >= 2 * windows.length]
            parts = [h.x[min(h.size // 2, h.size - 2 * windows.length) :] for h in holds]
            powers = [windows.powers(part) for part in parts]
            amplitude = choose_amplitude(windows, powers, self.rig.weights) if powers else None
            if amplitude is None:
                continue
            units = self.summed.weight.max(axis=1, keepdims=True)  # 0: the channel is new
            weight = np.where(units > 0.0, units * (amplitude.weight > 0.0), amplitude.weight)
            weight *= windows.frequency < lowest
            most = max(float((weight * power.mean(axis=0)).sum()) for power in powers)
            if most > (s.clear**2 - 1.0) * math.exp(2.0 * self.rig.sense * static_map.least):
                return windows.length  # with it the best amplitude may be another
        return None

    def _is_slower(self, static_map: StaticMap) -> bool:
        """Return whether in the valley most of what is left is slower than windows resolve.

        An interference does so everywhere; what theta makes of the rig does so more than beside.
        """
        from scipy.stats import norm, ttest_ind  # slow to import

        length = self.windows.length
        parts = [
            hold.x[min(level.skip, level.count - 2) * length :]
            for hold, level in zip(self.holds, self.levels(), strict=True)
        ]
        slow = np.log([self.summed.slower(part) for part in parts])
        u, valley = np.array([hold.u for hold in self.holds]), static_map.valley()
        below, above = u < valley.low, u > valley.high
        inside, sides = slow[~(below | above)], (slow[below], slow[above])
        if self.rig.sense < 0.0 or not np.median(inside) > 2.0 * static_map.least:
            return False
        least, sure = 2.0 * math.log(self._settings.clear), norm.sf(self._settings.slower)
        return any(
            min(inside.size, side.size) > 1
            and ttest_ind(inside - least, side, equal_var=False, alternative="greater").pvalue
            < sure
            for side in sides
        )

    @property
    def _floor(self) -> float:
        """The least y that a hold can have: what is weaker is hidden by the background."""
        if self.amplitude is None or self.rig.sense < 0.0:
            return -math.inf
        return math.log(self.amplitude.floor)

    def _tolerance(self, static_map: StaticMap) -> float:
        return max(self._settings.improvement, 0.5 * float(np.median(static_map.error)))

    def _bracket(self, static_map: StaticMap) -> float | None:
        """Return a position between the best and a neighbour that is far worse."""
        s, best = self._settings, static_map.best()
        y = static_map.predict(static_map.u)[0] - static_map.least
        for side in (-1.0, 1.0):
            beyond = side * (static_map.u - best)
            if not (beyond > 0.0).any():
                continue
            i = int(np.argmin(np.where(beyond > 0.0, beyond, np.inf)))
            if y[i] > math.log(s.steep) and beyond[i] > s.finest:
                return 0.5 * (best + float(np.clip(static_map.u[i], 0.0, 1.0)))
        return None

    def _gap(self, near: float) -> float | None:
        """Return the middle of a gap in which a narrow valley would hide, the nearest first."""
        places = np.unique([hold.u for hold in self.holds])
        middles = 0.5 * (places[1:] + places[:-1])[np.diff(places) > self._settings.gap]
        return float(min(middles, key=lambda u: abs(u - near))) if middles.size else None

    def _beside_rival(self, static_map: StaticMap) -> float | None:
        """Return a position beside the floor of a second valley, a ridge away from the best."""
        s, best, u = self._settings, static_map.best(), np.unique(np.clip(static_map.u, 0.0, 1.0))
        y, deviation = static_map.predict(u)
        for i in np.argsort(y):
            if y[i] > static_map.least + math.log(s.rival):
                break
            way = np.flatnonzero((u - u[i]) * (u - best) < 0.0)
            beside = [k for k in (i - 1, i + 1) if 0 <= k < u.size]
            if not way.size or min(y[k] for k in beside) < y[i]:
                continue
            top = way[np.argmax(y[way])]
            if y[top] - y[i] > 2.0 * math.hypot(deviation[top], deviation[i]):
                for k in beside:
                    if abs(u[k] - u[i]) > 0.5 * s.gap:
                        return float(0.5 * (u[k] + u[i]))
        return None

    def _doubtful_end(self, static_map: StaticMap) -> Move | None:
        """Return an end that may be as good as the best, or the best if that is known less well."""
        s, best = self._settings, static_map.best()
        for end, inner in ((0.0, s.beside), (1.0, 1.0 - s.beside)):
            count = sum(hold.u == end for hold in self.holds)
            step, sure = static_map.worse_by(end)
            if best == end:
                if not any(abs(hold.u - inner) < 0.5 * s.beside for hold in self.holds):
                    return Move(inner)
                if count < (3 if static_map.best_end is not None else s.ends):
                    return self._visit(end)
            elif step < 0.5 and sure < MAP.ends + 1.0 and count < s.ends:
                deviations = static_map.predict(np.array([end, best]))[1]
                return self._visit(end if deviations[0] >= deviations[1] else best)
        return None

    def _unknown_edge(self, static_map: StaticMap) -> float | None:
        """Return where the valley may end, if that is not known well enough."""
        s, basin = self._settings, static_map.basin()
        valley = static_map.valley()
        bound = static_map.least + math.log(MAP.good)
        doubt = 1.96 * static_map.deviation - np.abs(static_map.sense * static_map.curve - bound)
        inside = (static_map.grid >= basin.low) & (static_map.grid <= basin.high)
        unknown = float(np.mean((doubt > 0.0) & inside))
        if unknown <= max(s.edge * valley.width, 2.0 * s.finest):
            return None
        u = float(static_map.grid[int(np.argmax(np.where(inside, doubt, -np.inf)))])
        near = min(abs(hold.u - u) for hold in self.holds)
        return u if near > 0.25 * s.finest else None

    def _confirm(self, static_map: StaticMap) -> Move | None:
        """Return the best again from a side from which it was not come to."""
        best, valley = static_map.best(), static_map.valley()
        near = max(self._settings.same * valley.width, self._settings.finest)
        sides = {h.side for h in self.holds if h.confirms and abs(h.u - best) <= near}
        self._growth = True
        for side in (1, -1):
            inner = 0.0 < best < 1.0
            if inner and side not in sides:
                via = min(max(best - side * self._settings.overshoot, 0.0), 1.0)
                return Move(best, via, "the best again, from the other side")
        return None

    def _visit(self, u: float) -> Move:
        """Return a move to a position at which theta may be already: a hold is an arrival."""
        if self.holds and self.holds[-1].u == u:
            away = self._settings.overshoot * (1.0 if u < 0.5 else -1.0)
            return Move(u, u + away)
        return Move(u)

    def static_map(self) -> StaticMap:
        """Return the map of the finished holds, as it is now."""
        assert self.amplitude is not None, "nothing reacts"
        levels, sizes = self.levels(), np.array([hold.size for hold in self.holds])
        proven = self._find_proven(self.holds, levels)
        columns = ([h.u for h in self.holds], [x.mean for x in levels], [x.error for x in levels])
        u, mean, error = np.array(columns)[:, proven]
        static_map = StaticMap(u, mean, error, self.rig.sense)
        return static_map.now((np.cumsum(sizes) - 0.5 * sizes)[proven])

    def _find_proven(self, holds: Sequence[Hold], levels: Sequence[Level]) -> NDArray[np.bool_]:
        """Return which holds tell what the rig comes to."""
        return find_proven(np.array([hold.u for hold in holds]), levels, self.rig.sense)

    def levels(self) -> list[Level]:
        """Return the level of each finished hold."""
        amplitude, wander = self.summed, self._wander()
        return [hold.level(amplitude, wander) for hold in self.holds]

    def _wander(self) -> float:
        """Return how slowly the amplitude comes and goes, as most holds show it."""
        return usual_wander([hold.level(self.summed).wander for hold in self.holds])

    @property
    def summed(self) -> Amplitude:
        """What reacts; everything until that is known."""
        if self.amplitude is not None:
            return self.amplitude
        assert self._heard is not None, "look first"
        return whole_amplitude(self.windows, self._heard.x)

    # -- how long theta is held -----------------------------------------------------------------

    def arrive(self, move: Move, elapsed: float, number: int = -1) -> None:
        """Begin a hold, after so much of the rig's time [s], with its number."""
        s = self._settings
        before = self._hold.u if move.via is None else move.via
        self._hold = Hold(
            move.u, int(np.sign(move.u - before)), np.empty((0, len(self.rig.names))), number,
            move.why, elapsed,
        )  # fmt: skip
        self._next, self._usual, self._target = 0, self._wander(), self._target_error()
        least = s.brief * self.windows.length
        known = [*self.holds, *(hold for hold, _ in self._others if hold.size >= least)]
        levels = [self.rig.sense * hold.level(self.summed).mean for hold in known]
        self._best = min(levels, default=math.inf)
        self._elapsed = elapsed
        left = max(self.rig.time - elapsed, 0.0)
        # about half of it is for what follows the first positions
        share = left / (len(self._queue) + 2 * s.first if self._queue else 2)
        fair = min(s.most_share * self.rig.time, share)
        self._most = max(s.fewest, int(fair / self.windows.seconds))
        self._least = min(self._needed_windows(), self._most)

    def _needed_windows(self) -> int:
        """Return for how many windows theta is held at least: the rig was seen to be slow."""
        s = self._settings
        least = round(self._patience * (s.brief if self._brief else s.fewest))
        if not self.holds or self._brief:
            return least
        levels = self.levels()
        skips = [level.skip if abs(level.rise) > self._target else 0 for level in levels]
        settling = float(np.quantile(skips, s.usual)) * s.reserve  # a slight change is none
        if self._growth:
            settling = max(settling, s.growth * longest_growth(levels, self.rig.sense))
        return math.ceil(settling) + least

    def take(self, x: Array, ended: bool = False) -> bool:
        """Take the samples of a window; return whether theta may go on.

        Of a hold that has ``ended``, all samples: whether it is long enough to count.
        """
        hold = self._hold
        hold.append(x)
        count = hold.size // self.windows.length
        if not (count >= self._settings.brief if ended else self._is_enough(count)):
            return False
        hold.confirms = self._growth
        self.holds.append(hold)
        if self._queue:
            self._queue.pop(0)
        self._choose()
        return True

    def _is_enough(self, count: int) -> bool:
        """Return whether a hold of so many windows tells what it should, or took its share."""
        s, hold = self._settings, self._hold
        if count < max(self._least, self._next):
            return False
        self._next = count + 1 + int(s.soon * count)
        if count >= self._most:
            return True
        level = hold.level(self.summed, self._usual)
        if self._brief and self.rig.sense * level.mean + 2.0 * level.error < self._expected:
            self._brief = False  # a valley, or an oscillation that has not grown yet
            self._least = min(self._needed_windows(), self._most)
            return False
        worse = self.rig.sense * level.mean - self._best
        enough = max(self._target, worse * s.error_of_worse, s.error_of_gap * self._brief)
        if level.error > enough or not level.is_settled(s.trend * enough):
            return False
        return bool(self._find_proven([*self.holds, hold], [*self.levels(), level])[-1])

    def _target_error(self) -> float:
        """Return the standard error at which a hold is known well enough."""
        s = self._settings
        means = [level.mean for level in self.levels()]
        error = max(s.error, s.error_of_span * float(np.ptp(means)) if means else 0.0)
        return min(error, s.error_of_best) if self._growth else error

    def _choose(self) -> None:
        """Choose what is summed, and the windows for it, from all holds so far."""
        place = self._place or (lambda u: np.array([u]))
        at = dict(self._others) | {hold: place(hold.u) for hold in self.holds}
        nowhere = np.full_like(place(0.0), math.nan)  # what was heard before theta moved
        holds = [*([self._heard] if self._heard else []), *at]
        holds = [hold for hold in holds if hold.size >= 2 * self.windows.length]
        if len(holds) < 2:
            return
        s, before = self._settings, self.windows
        for last in (False, False, True):
            powers = [hold.late(self.windows) for hold in holds]
            places = [(at.get(h, nowhere), 0 if self._place else h.side) for h in holds]
            hidden = find_hidden(*zip(*(hold.steps() for hold in holds), strict=True))
            known = self.windows, powers, self.rig.weights, places, hidden
            if last or (reacts := choose_amplitude(*known, beside=True)) is None:
                break
            squares = [float(reacts.squares(p).mean()) for p in powers]
            if max(squares) < s.clear**2 * max(min(squares), 0.0):
                break  # of what reacts a little the frequency is not known
            y = self.rig.sense * reacts.log(np.array(squares))
            means = [p.mean(axis=0) for p in powers]
            moves = np.array([(reacts.weight * mean).any() for mean in means])  # has a period
            near = np.flatnonzero(moves & (y <= y[moves].min() + math.log(s.far)))
            self.period = reacts.period([means[i] for i in near])
            length = window_length(self.period, s.window, self.rig.dt)
            if self._slow:  # shorter ones hid it; in a few holds a drift looks alike
                length = self.windows.length if self._queue else max(length, self.windows.length)
            elif not self._queue:
                longest = min(hold.size for hold in holds) // s.brief
                length = min(length, max(longest, 64, self.windows.length))
            if 0.7 < length / self.windows.length < 1.5:
                break
            self.windows = self.windows._replace(length=length)
            holds = [hold for hold in holds if hold.size >= s.brief * length]
            if len(holds) < 2:
                break
        if self.windows != before:  # at the first positions theta goes again where it was shorter
            least = s.brief * self.windows.length
            short = [hold.u for hold in self.holds if hold.size < least]
            self.holds = [hold for hold in self.holds if hold.size >= least]
            there = {*self._queue, *(hold.u for hold in self.holds)}
            self._queue += [u for u in dict.fromkeys(short) if u not in there]
        unsteady = partial(unsteady_shares, self.windows, holds)
        self.amplitude = choose_amplitude(*known, unsteady=unsteady) if len(holds) > 1 else None

    @property
    def left(self) -> int:
        """How many holds are to come at least."""
        return len(self._queue)


def first_positions(count: int, up: bool) -> list[float]:
    """Return positions from end to end, and those between on the way back.

    >>> first_positions(3, True)
    [0.0, 0.5, 1.0, 0.75, 0.25]
    """
    way = [i / (count - 1) for i in range(count)]
    back = [(i + 0.5) / (count - 1) for i in range(count - 1)]
    return [*way, *back[::-1]] if up else [*way[::-1], *back]
