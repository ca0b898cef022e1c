"""What an excitation decides of all knobs of a rig: sections, and a bowl between them.

A rig with one knob has one section. With several:

1. Each knob in turn goes over its range, the others where the best was seen so far.
2. A knob without effect there is gone over again where the amplitude is away from its best. If it
   has none, it is named, and stays at its start, unless a line between knobs lets it make room for
   another.
3. Two holds to either side of each pair of knobs tell how they are coupled: at the least of the
   bowl that fits all holds (:mod:`koop_tune.excitation.bowl`) theta is held, until none is better;
   at a line between knobs it goes along that.
4. Through the best, each knob's section is found out as that of a rig with one knob
   (:class:`koop_tune.excitation.design.Design`), and one without effect is gone over once more.
5. A valley that runs aslant looks like a pit along each knob: theta is held on both diagonals of
   the rectangle that the valleys of two sections span, and goes on along the better one.

Steps 3 to 5 are repeated while the best moves or lies beside all sections, or where windows became
longer meanwhile. The holds grow with n^2, not exponentially. A valley elsewhere is not found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import Settings, judged
from koop_tune.excitation.amplitude import Amplitude, Windows
from koop_tune.excitation.bowl import BOWL, Bowl, fit_bowl
from koop_tune.excitation.design import (
    DESIGN,
    FLAT,
    KNOWN,
    Design,
    Move,
)
from koop_tune.excitation.holds import Hold, Level, usual_wander
from koop_tune.excitation.static_map import MAP, StaticMap
from koop_tune.rig.rig_file import RigFile

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnobsSettings(Settings):
    """When the coupling of knobs is known."""

    gain: float = judged(
        0.1,
        "log amplitude that a place must gain to be held at or the base, or a trend to be one",
        low=0.0,
    )
    steps: int = judged(4, "holds at it for each knob, at most", low=1)
    cycles: int = judged(4, "times that the sections are found out while the best moves", low=1)
    away: float = judged(2.0, "amplitude over the best beside a section's best, at first", low=1.0)
    least: float = judged(0.03, "distance of these, at least, in ranges", low=1e-3, high=0.5)
    most: float = judged(0.3, "the same at most", low=1e-3, high=0.5)
    trend: float = judged(
        12.0, "chi-squared that a parabola takes off what a section has about a constant", low=0.0
    )
    near: float = judged(
        0.02,
        "distance of a recorded hold from a place off all sections that stands for it",
        low=0.0,
    )
    same: float = judged(0.004, "distance of two holds at one place, in ranges", low=0.0)
    room: float = judged(
        0.15, "section that lines between knobs leave, at least, in ranges", low=0.0
    )
    spread: int = judged(5, "positions of a section beside the best, at least", low=5)
    gap: float = judged(0.2, "widest gap between two holds of a section, in ranges", low=0.0)


KNOBS = KnobsSettings()
ASLANT = "where a valley may run aslant"


class KnobsMove(NamedTuple):
    """Where theta goes: positions of the next hold, of one to pass on the way, and why."""

    u: Array
    via: Array | None = None
    why: str = ""


class RecordedHold(NamedTuple):
    """A hold of an interrupted excitation: positions, shape (n,), samples, and when it began."""

    u: Array
    x: Array
    elapsed: float


class KnobsDesign:
    """The decisions of an excitation, of one knob or several; it is used as a :class:`Design` is.

    Parameters
    ----------
    rig : RigFile
        The rig.
    recorded : sequence of RecordedHold
        What an interrupted one recorded: theta need not go there again.

    Attributes
    ----------
    rig : RigFile
        The rig; its time may be set longer.
    ended : str
        As a Design's.
    sections : dict of int to list of Hold
        Holds of each knob that has an effect through the best, their ``u`` the knob's position.
    lines : dict of int to ndarray, shape (n,)
        A position of each of these sections.
    base : ndarray, shape (n,)
        The best position so far.
    """

    def __init__(self, rig: RigFile, recorded: Sequence[RecordedHold] = ()) -> None:
        self.rig, self.ended = rig, ""
        self.sections: dict[int, list[Hold]] = {}
        self.lines: dict[int, Array] = {}
        self.base = self._start = rig.u(rig.each("theta_start"))
        self._useful = list(range(rig.count))
        self._to_come = 0  # holds after the present section, at least
        several = replace(DESIGN, gap=KNOBS.gap, error=BOWL.error)
        self._of_section = several if rig.count > 1 else DESIGN
        self._recorded, self._arrivals = list(recorded), 0
        self._done: list[tuple[Hold, Array]] = []
        self._look_along(0, self.base)
        self._design = Design(rig.knob(0), settings=self._of_section)
        self._moves = self._plan()
        self.listens, self.look = self._design.listens, self._design.look

    @property
    def windows(self) -> Windows:
        """How samples are cut."""
        return self._design.windows

    @property
    def amplitude(self) -> Amplitude | None:
        """What is summed; None until something reacts."""
        return self._design.amplitude

    @property
    def since(self) -> float:
        """As a Design's; of several knobs, all holds count."""
        return self._design.since if self.rig.count == 1 else 0.0

    @property
    def left(self) -> int:
        """As a Design's, of the present section."""
        return self._design.left

    @property
    def needed(self) -> tuple[float, float]:
        """As a Design's, of all knobs: what is to come after the present section counts, too."""
        first, whole = self._design.needed
        knobs = max(self.rig.count - len(self.lines), 1)
        return knobs * first, whole + self._to_come * self._design.hold_seconds

    @property
    def held(self) -> list[tuple[Hold, Array]]:
        """Finished holds in order, each with its positions."""
        own = [(hold, self._at(hold.u)) for hold in self._design.holds]
        held = [item for item in (*self._done, *own) if self._is_long(item[0])]
        return sorted(held, key=lambda item: item[0].number)

    def _is_long(self, hold: Hold) -> bool:
        """Return whether a hold is long enough for the windows of now."""
        return hold.size >= self._of_section.brief * self.windows.length

    def _is_short(self, section: Sequence[Hold]) -> bool:
        """Return whether windows became longer since most of a section's holds."""
        return len({hold.u for hold in section if self._is_long(hold)}) < KNOBS.spread

    def levels(self) -> list[Level]:
        """Return the level of each of them."""
        return self._levels_of([hold for hold, _ in self.held])

    def _levels_of(self, holds: Sequence[Hold]) -> list[Level]:
        amplitude = self._design.summed
        wander = usual_wander([hold.level(amplitude).wander for hold in holds])
        return [hold.level(amplitude, wander) for hold in holds]

    def next(self) -> KnobsMove | None:
        """Return where theta goes next; None once enough is known."""
        while (move := next(self._moves, None)) is not None and self._take_recorded(move):
            pass
        return move

    def _take_recorded(self, move: KnobsMove) -> bool:
        """Take the hold that was recorded there; return False if none was, or a short one."""
        for i, recorded in enumerate(self._recorded):
            if np.abs(recorded.u - move.u).max() < self._of_section.passed:
                del self._recorded[i]
                self.arrive(move, recorded.elapsed)
                return self._design.take(recorded.x, ended=True)
        return False

    def arrive(self, move: KnobsMove, elapsed: float) -> None:
        """As :meth:`Design.arrive`."""
        self._design.rig = replace(self._part, time=self.rig.time)
        via = None if move.via is None else self._on(move.via)
        at = Move(self._on(move.u), via, move.why)
        self._arrivals += 1
        self._design.arrive(at, elapsed, self._arrivals)

    def take(self, x: Array) -> bool:
        """As :meth:`Design.take`."""
        return self._design.take(x)

    def section(self, knob: int) -> StaticMap:
        """Return the map over one knob through the best."""
        holds = list(filter(self._is_long, self.sections[knob]))
        levels = self._levels_of(holds)
        return StaticMap(
            np.array([hold.u for hold in holds]), np.array([level.mean for level in levels]),
            np.array([level.error for level in levels]), self.rig.sense,
        )  # fmt: skip

    def _has_effect(self, knob: int) -> bool:
        """Return whether a section shows an effect: a trend does before its scatter does."""
        section = self.section(knob)
        error = np.maximum(section.error, MAP.least_error)  # as of the section's chi-squared
        trend = np.polyval(np.polyfit(section.u, section.mean, 2, w=1.0 / error), section.u)
        left = float((((section.mean - trend) / error) ** 2).sum())
        sure = section.chi_squared - left > KNOBS.trend
        return not section.flat or (sure and float(np.ptp(trend)) > KNOBS.gain)

    def _matters(self, knob: int, effective: set[int]) -> bool:
        """Return whether a knob has an effect, or a line lets it make room for one that has."""
        return knob in effective or any(
            line.weights[knob] != 0.0 and any(line.weights[k] != 0.0 for k in effective)
            for line in self.rig.lines
        )

    # -- where theta goes -----------------------------------------------------------------------

    def _plan(self) -> Iterator[KnobsMove]:
        if self.rig.count == 1:
            yield from self._along(0)
            self.ended, self.sections = self._design.ended, {0: self._design.holds}
            self.lines = {0: self.base}
            return
        knobs = range(self.rig.count)
        lines: dict[int, list[Hold]] = {knob: [] for knob in knobs}
        over, n = 2 * self._of_section.first - 1, self.rig.count
        whole = over + 2
        for knob in (*knobs, *knobs):  # again where windows became longer meanwhile
            if self._is_short(lines[knob]):
                left = n - 1 - len(self.lines)
                self._to_come = max(left, 0) * over + n * (n - 1) * 5 // 2 + n * whole
                yield from self._along(knob, whole=False)
                lines[knob], self.lines[knob] = self._design.holds, self._through
                self._move_base()
        if self.amplitude is None:
            self.ended = FLAT
            return
        self.sections = lines
        effective = set(filter(self._has_effect, knobs))
        if not effective:
            self.ended = FLAT
            return
        for knob in sorted(set(knobs) - effective):  # such as a phase where the gain is best at 0
            u, y, _ = self.arrays
            self.base = u[int(np.argmin(np.abs(y - y.min() - math.log(KNOBS.away))))]
            yield from self._along(knob, np.linspace(0.0, 1.0, KNOBS.spread).tolist(), False)
            lines[knob], self.lines[knob] = self._design.holds, self._through
            if self._has_effect(knob):
                effective.add(knob)
            self._move_base()
        self._useful = [knob for knob in knobs if self._matters(knob, effective)]
        self._move_base()
        self._to_come = len(self._useful) * whole
        way = {knob: self._width(knob) for knob in self._useful}
        for a, b in itertools.combinations(self._useful, 2):
            for side in (1.0, -1.0):
                place = self._beside({a: way[a], b: side * way[b]})
                yield from self._hold_at(place, "how two knobs are coupled")
        self.sections, self.lines = {}, {}
        for cycle in itertools.count(1):
            before = self._arrivals
            yield from self._descend()
            yield from self._slide()
            for i, knob in enumerate(self._useful, start=1):
                self._to_come = (len(self._useful) - i) * whole
                best, width = self.base[knob], self._half_width(knob)
                ends = max(best - width, 0.0), min(best + width, 1.0)
                first = np.linspace(*ends, KNOBS.spread).tolist()
                yield from self._along(knob, first, knob in effective)
                self.sections[knob], self.lines[knob] = self._design.holds, self._through
                if self._has_effect(knob):
                    effective.add(knob)
                self._move_base()
            found = [knob for knob in knobs if knob not in self._useful and cycle == 1]
            for knob in found:  # what hid its effect may be gone at the best
                yield from self._along(knob, np.linspace(0.0, 1.0, KNOBS.spread).tolist(), False)
                self.sections[knob] = self._design.holds
                if not self._has_effect(knob):
                    del self.sections[knob]
                self._move_base()
            self._useful = sorted(self.sections)
            if any(map(self._is_short, self.sections.values())):
                continue
            moves = set(found) & self.sections.keys() or self._least_of_bowl() is not None
            if not moves:
                yield from self._go_aslant()
                moves = self._least_of_bowl() is not None
            enough = cycle >= KNOBS.cycles or not moves
            if enough and (self._is_on_section() or self._arrivals == before):
                break
        self.ended = KNOWN

    def _is_on_section(self) -> bool:
        """Return whether a section goes through the base, as far as lines leave room there.

        Where what is summed changes with the last holds, another one may be the best of all.
        """
        others = ~np.eye(self.base.size, dtype=bool)
        return any(
            np.abs(self._with_room(knob) - line)[others[knob]].max() <= KNOBS.same
            for knob, line in self.lines.items()
        )

    def _along(
        self, knob: int, first: Sequence[float] | None = None, whole: bool = True
    ) -> Iterator[KnobsMove]:
        """Find out a section through the base; or only go to the first positions."""
        others, on, held = np.arange(self.base.size) != knob, [], self.held
        self._done = []
        self._look_along(knob, self._with_room(knob))
        for hold, u in held:
            if np.abs(u - self._through)[others].max() > KNOBS.same:
                self._done.append((hold, u))
                continue
            on.append(copy(hold))
            on[-1].u, on[-1].confirms = self._on(u), False
        if first is not None:
            first = list(dict.fromkeys(self._on(np.full(self.base.size, u)) for u in first))
            if len(first) < KNOBS.spread and self._part.span < self.rig.knob(knob).span:
                first = np.linspace(0.0, 1.0, KNOBS.spread).tolist()
        self._begin(on, first)
        choose = self._design.next if whole else self._design.next_first
        while (move := choose()) is not None:
            via = None if move.via is None else self._at(move.via)
            yield KnobsMove(self._at(move.u), via, move.why)

    def _begin(self, holds: Sequence[Hold], first: Sequence[float] | None) -> None:
        """Begin to decide about a knob, all holds elsewhere known."""
        if self._done or holds:  # else it is the first, which knows what was heard
            self._design = Design(
                self._part, holds, None, self._of_section, self._design, self._done, first,
                self._at,
            )  # fmt: skip

    def _look_along(self, knob: int, place: Array) -> None:
        """Let the section be that of a knob through a place."""
        self._section, self._through = knob, place
        self._part = self.rig.section(knob, self.rig.theta_at(place))

    def _with_room(self, knob: int) -> Array:
        """Return the base; where lines leave a knob hardly any room, a place nearer theta_safe."""
        rig, theta = self.rig, np.array(self.rig.theta_at(self.base))
        for share in np.linspace(0.0, 1.0, 33) if rig.lines else ():
            place = theta + share * (rig.each("theta_safe") - theta)
            low, high = rig.room(knob, place.tolist())
            if high - low >= KNOBS.room * rig.knob(knob).span:
                return rig.u(place) if share else self.base
        return self.base

    def _at(self, u: float) -> Array:
        """Return where theta is if the knob is at a position of its section."""
        place, k, part = self._through.copy(), self._section, self._part.scale
        whole = self.rig.scales[k]
        place[k] = u if part == whole else whole.u(part.theta(np.array(u)))
        return place

    def _on(self, u: Array) -> float:
        """Return the position on the section of the knob's at a place; rounded, for its ends."""
        k, part = self._section, self._part.scale
        whole = self.rig.scales[k]
        return float(u[k] if part == whole else np.round(part.u(whole.theta(u[k])), 12))

    def _keep(self, u: Array) -> Array:
        """Return a place within the lines between knobs."""
        return self.rig.u(self.rig.limit(self.rig.theta_at(u))) if self.rig.lines else u

    def _hold_at(self, u: Array, why: str) -> Iterator[KnobsMove]:
        """Hold once at some place."""
        recorded = [hold.u for hold in self._recorded if np.abs(hold.u - u).max() < KNOBS.near]
        u = recorded[0] if recorded else u  # a resumed one comes to about the same place
        self._done = self.held
        self._look_along(self._section, u)
        self._begin((), ())
        yield KnobsMove(u, None, why)
        self._done += [(hold, u) for hold in self._design.holds]
        self._design.holds = []
        self._move_base()

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """Positions, shape (M, n), y and errors, shape (M,), of all holds."""
        levels = self.levels()
        y = self.rig.sense * np.array([level.mean for level in levels])
        return np.array([u for _, u in self.held]), y, np.array([level.error for level in levels])

    def _move_base(self) -> None:
        """Make the best hold the base; knobs without effect rest at their start.

        Where it gains little the base stays: sections through it are known.
        """
        self._done, self._design.holds = self.held, []
        if self.amplitude is not None:
            u, y, error = self.arrays
            useful = np.isin(np.arange(self.base.size), self._useful)
            best, here = int(np.argmin(y + error)), np.abs(u - self.base).max(axis=1) <= KNOBS.same
            if y[here].min(initial=math.inf) > y[best] + KNOBS.gain:
                self.base = u[best]
            self.base = self._keep(np.where(useful, self.base, self._start))

    def _beside(self, ways: dict[int, float]) -> Array:
        """Return a place away from the base along some knobs, towards the middle of the range."""
        place = self.base.copy()
        for knob, way in ways.items():
            place[knob] += way if place[knob] < 0.5 else -way
        return self._keep(np.clip(place, 0.0, 1.0))

    def _half_valley(self, knob: int, level: float) -> float:
        """Return half the width of a knob's section where it is within a level of its best."""
        rig, valley = self.rig, np.array(self.section(knob).valley(level))
        part = rig.section(knob, rig.theta_at(self.lines[knob])).scale
        return 0.5 * float(np.ptp(rig.scales[knob].u(part.theta(valley))))

    def _width(self, knob: int) -> float:
        """Return half the width of a knob's section where it is away times its best."""
        if self._is_short(self.sections[knob]):
            return KNOBS.most
        return min(max(self._half_valley(knob, KNOBS.away), KNOBS.least), KNOBS.most)

    def _go_aslant(self) -> Iterator[KnobsMove]:
        """Hold on the diagonals of each two knobs' valleys, farther and farther while it is good.

        A narrow valley runs along one of them, whatever way it goes: the ratio of the widths that
        the sections see is that of its direction.
        """
        base, width = self.base, {k: self._half_valley(k, MAP.good) for k in self._useful}
        for a, b in itertools.combinations(self._useful, 2):
            up, down = np.zeros((2, base.size))
            up[a] = down[a] = width[a]
            up[b], down[b] = width[b], -width[b]
            levels = []
            for way in (up, down):
                place = self._keep(np.clip(base + way, 0.0, 1.0))
                yield from self._hold_at(place, ASLANT)
                levels.append(self._level_at(place))
            better = up if levels[0] < levels[1] else down
            for way, level in ((2.0 * better, min(levels)), (-better, -math.inf)):
                while level < self.arrays[1].min() + math.log(MAP.good):
                    if (place := base + way).min() < 0.0 or place.max() > 1.0:
                        break
                    place = self._keep(place)
                    yield from self._hold_at(place, ASLANT)
                    level, way = self._level_at(place), 2.0 * way
            if not np.array_equal(self.base, base):
                return

    def _level_at(self, place: Array) -> float:
        """Return y of the hold nearest to a place."""
        u, y, _ = self.arrays
        return float(y[np.argmin(np.abs(u - place).max(axis=1))])

    def _half_width(self, knob: int) -> float:
        """Return how far from the base, along a knob, the bowl is away times that there."""
        s, bowl, base = KNOBS, self._bowl(), self.base[self._useful]
        widths = np.linspace(s.least, s.most, 28)
        way = np.eye(base.size)[self._useful.index(knob)]
        y = np.minimum(*(bowl.log(base + side * widths[:, None] * way) for side in (-1.0, 1.0)))
        beyond = widths[y > bowl.log(base[None]) + math.log(s.away)]
        return float(beyond[0]) if beyond.size else s.most

    def _bowl(self) -> Bowl:
        u, y, error = self.arrays
        return fit_bowl(u[:, self._useful], y, error)

    def _least_of_bowl(self) -> Array | None:
        """Return the place of the bowl's least; None where it gains nothing."""
        u, y, _ = self.arrays
        bowl = self._bowl()
        place = self.base.copy()
        place[self._useful] = bowl.best
        if self.rig.lines:
            place = self._keep(least_within(self.rig, bowl, self._useful, self.base))
        gain = float(y.min()) - float(bowl.log(place[None, self._useful])[0])
        near = float(np.abs(u - place).max(axis=1).min())
        return place if gain > KNOBS.gain and near > KNOBS.same else None

    def _descend(self) -> Iterator[KnobsMove]:
        for _ in range(KNOBS.steps * len(self._useful)):
            if (place := self._least_of_bowl()) is None:
                return
            yield from self._hold_at(place, "the least of the bowl that fits all holds")

    def _slide(self) -> Iterator[KnobsMove]:
        """Go along the lines that the base is at for as long as that gains."""
        step = KNOBS.most
        while step >= KNOBS.least:
            before = self.base
            for place in self._places_on_lines(step):
                yield from self._hold_at(place, "along a line between knobs")
                if not np.array_equal(self.base, before):
                    break
            else:
                step *= 0.5

    def _places_on_lines(self, step: float) -> Iterator[Array]:
        """Return places beside the base on each line that it is at, a step of a knob away."""
        rig, spans = self.rig, np.array([one.span for one in self.rig.knobs()])
        for line in rig.lines:
            knobs = [knob for knob in self._useful if line.weights[knob]]
            room = -line.excess(rig.theta_at(self.base)) / np.abs(line.weights)[knobs]
            if (room / spans[knobs]).min(initial=math.inf) > KNOBS.same:
                continue
            for (a, b), side in itertools.product(itertools.combinations(knobs, 2), (1.0, -1.0)):
                place = self.base.copy()
                place[a] = min(max(place[a] + side * step, 0.0), 1.0)
                there = list(rig.theta_at(place))
                there[b] -= line.excess(there) / line.weights[b]
                place = self._keep(rig.u(there))
                if min(np.abs(place - u).max() for _, u in self.held) > KNOBS.same:
                    yield place


def least_within(rig: RigFile, bowl: Bowl, knobs: Sequence[int], base: Array) -> Array:
    """Return the place of a bowl's least over some knobs within lines, the others as at base."""
    from scipy.optimize import minimize  # slow to import

    spans = np.ptp([rig.each("theta_min"), rig.each("theta_max")], axis=0)
    sizes = [float(np.abs(line.weights) @ spans) for line in rig.lines]

    def place(u: Array) -> Array:
        at = base.copy()
        at[list(knobs)] = np.clip(u, 0.0, 1.0)
        return at

    def left(u: Array) -> list[float]:
        theta = rig.theta_at(place(u))
        return [-line.excess(theta) / size for line, size in zip(rig.lines, sizes, strict=True)]

    found = minimize(
        lambda u: float((((u - bowl.best) @ bowl.root.T) ** 2).sum() / (bowl.root**2).sum()),
        base[list(knobs)], method="SLSQP", bounds=[(0.0, 1.0)] * len(knobs),
        constraints={"type": "ineq", "fun": left}, tol=1e-9,
    )  # fmt: skip
    return place(found.x)
