"""What an excitation decides: what is heard first, where theta goes, when it goes on.

Theta goes up and down through its values, then through them at random, so that neither a memory of
the rig nor a drift is taken for the map. It rests at each until the rig has settled and the error
is small enough: longer where it is noisy. Beside a cliff of the static map values are added.

:class:`Survey` is told what the rig said, window by window, and says what is next; who moves theta
and who listens is another's, be it ``koop excite`` with a rig or a study with a simulated one.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.config.parameter import parameter, validate
from koop_core.errors import InputError
from koop_tune.excitation.channels import find_lines, should_listen
from koop_tune.excitation.features import (
    Bands,
    bridge_gaps,
    choose_bands,
    log_amplitudes,
    window_length,
)
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.excitation.static_map import StaticMap
from koop_tune.excitation.visits import Visit, summarise
from koop_tune.origin import jsbsim, studied
from koop_tune.rig.rig_file import RigFile


@dataclass(frozen=True)
class SurveySettings:
    """When enough was heard, how long theta rests, and when the map is known."""

    window: float = studied(4.0, "window, in periods of the strongest oscillation", low=1.0)
    slowest: float = studied(2.0, "the same of the slowest one, if longer", low=1.0)
    listen: float = studied(40.0, "periods before theta moves", low=1.0)
    shortest: float = parameter(3.0, "time of that at least", unit="s", low=0.1)
    longest: float = parameter(120.0, "time of that at most", unit="s", low=1.0)
    longest_share: float = parameter(0.02, "the same over the rig file's time, if more", low=0.0)
    fewest: int = studied(6, "windows at a value", low=4)
    reserve: float = studied(2.0, "rest, in times that the rig was seen to need", low=1.0)
    most_share: float = parameter(0.15, "longest rest, over the rig file's time", low=0.01)
    soon: float = parameter(0.02, "share of a rest after which it is judged again", low=0.0)
    error: float = studied(0.03, "standard error that is good enough", low=1e-3)
    error_of_span: float = studied(0.05, "the same over the map's span, if more", low=0.0)
    visits: int = studied(6, "most visits of a value", low=2)
    visits_in_doubt: int = studied(16, "the same of one that leaves the optimum open", low=2)
    finest: float = jsbsim(0.04, "distance of two values, in ranges", low=1e-3, high=1.0)
    added: int = jsbsim(4, "values that are added", low=0, high=20)
    linger: int = jsbsim(48, "windows at a value beside a cliff", low=4)

    def __post_init__(self) -> None:
        validate(self)


SURVEY = SurveySettings()


class Periods(NamedTuple):
    """Periods of the oscillations before theta moves [s], the strongest and the slowest."""

    strongest: float
    slowest: float


class Survey:
    """An excitation's decisions.

    Parameters
    ----------
    rig : RigFile
        The rig.
    state : ExcitationProgress
        What was done; it grows.
    settings : SurveySettings
        Thresholds.
    """

    def __init__(
        self, rig: RigFile, state: ExcitationProgress, settings: SurveySettings = SURVEY
    ) -> None:
        self._rig = rig
        self._state = state
        self._settings = settings
        self._level = self._next = 0
        self._least = self._most = settings.fewest
        self._guides: list[int] = []
        self._target = settings.error
        self._series: list[NDArray[np.float64]] = []

    # -- before theta moves ---------------------------------------------------------------------

    def listens(self, x: NDArray[np.float64]) -> bool:
        """Return whether more must be heard than x, shape (M, n), before theta moves."""
        s = self._settings
        longest = max(s.longest, s.longest_share * self._rig.time)
        return should_listen(x, self._rig.dt, s.shortest, s.listen, longest)

    def look(self, x: NDArray[np.float64]) -> Periods:
        """Choose the windows from what was heard, shape (M, n).

        Raises
        ------
        koop_core.errors.InputError
            If no channel moves.
        """
        dt, x = self._rig.dt, bridge_gaps(x)
        peaks = [line for column in x.T for line in find_lines(column, dt)]
        if not peaks:
            raise InputError("no channel moves: dead sensors, or other fields")
        strongest = 1.0 / max(peaks, key=lambda line: line.share).frequency
        slowest = 1.0 / min(line.frequency for line in peaks)
        window = max(self._settings.window * strongest, self._settings.slowest * slowest)
        length = min(window_length(window, 1.0, dt), x.shape[0])
        self._state.bands = choose_bands(x, length, dt)
        return Periods(strongest, slowest)

    # -- where theta goes -----------------------------------------------------------------------

    def next_value(self) -> float | None:
        """Return where theta goes next; None once the static map is known well enough."""
        state = self._state
        if not state.queue:
            state.queue = self._next_round() or from_both_sides(self._add_values())
            if not state.queue:
                state.done = True
                return None
        return state.values[state.queue[0]]

    def _next_round(self) -> list[int]:
        """Return the values for another round, at random; empty if the map is known well enough.

        The first round has all of them.
        """
        state = self._state
        count = len(state.values)
        wanted = list(range(count))
        if len(state.visits) > state.staircase:
            wanted = self._wanted(state.static_map(self._feature(), self._rig.sense))
        random.Random(f"{state.seed} {len(state.visits)}").shuffle(wanted)
        last = state.visits[-1].level
        if len(wanted) > 1 and wanted[0] == last:
            wanted.append(wanted.pop(0))
        if len(wanted) == 1 and wanted[0] == last:  # a visit is an arrival
            wanted.insert(0, wanted[0] + (1 if wanted[0] + 1 < count else -1))
        return wanted

    def _wanted(self, static_map: StaticMap) -> list[int]:
        """Return the values at which the map is not known well enough, and may be some day."""
        s, visits = self._settings, [levels.size for levels in static_map.visits]
        target, doubtful = self._target_error(static_map), static_map.undecided
        cliff = self._state.added_values > 0  # what is beyond need not be known well
        worst = float(static_map.y.min()) + np.log(static_map.settings.cliff)
        return [
            i
            for i in range(static_map.u.size)
            if visits[i] < 2
            or (
                (not cliff or static_map.y[i] < worst)
                and (
                    (visits[i] < s.visits and static_map.error[i] > target)
                    or (visits[i] < s.visits_in_doubt and i in doubtful)
                )
            )
        ]

    def _target_error(self, static_map: StaticMap) -> float:
        """Return the standard error at which a map is known well enough."""
        return max(
            self._settings.error, self._settings.error_of_span * float(np.ptp(static_map.mean))
        )

    def _add_values(self) -> list[int]:
        """Add values between the good ones and a cliff, until it is known; return their numbers."""
        state, s = self._state, self._settings
        static_map = state.static_map(self._feature(), self._rig.sense)
        added: list[int] = []
        for side in (1, -1):  # the upper one first: the numbers below stay
            cliff = static_map.cliff(side)
            if cliff is None or state.added_values >= s.added:
                continue
            a, b = static_map.u[cliff.inner], static_map.u[cliff.outer]
            if abs(b - a) > s.finest:
                above = max(cliff.inner, cliff.outer)
                state.add(above, self._rig.scale.theta_at(0.5 * float(a + b)))
                added = [above, *(level + 1 for level in added)]
        return added[::-1]

    def arrive(self, elapsed: float) -> None:
        """Begin a rest at that value, after so much of the rig's time [s]."""
        state, bands, s = self._state, self._bands, self._settings
        self._level, self._series, self._next = state.queue[0], [], 0
        self._guides = self._guiding()
        self._least, self._target = s.fewest, s.error
        if state.visits:
            static_map = state.static_map(self._guides[0], self._rig.sense)
            self._target = self._target_error(static_map)
            if state.added_values and beside_cliff(static_map, state.reached, self._level):
                self._least = s.linger
        left = max(self._rig.time - elapsed, 0.0)
        fair = min(s.most_share * self._rig.time, 2.0 * left / self.visits_left)
        self._most = max(s.fewest, int(fair / (bands.length * bands.dt)))
        self._least = min(self._least, self._most)

    def take(self, x: NDArray[np.float64]) -> bool:
        """Take a window of samples, shape (length, n); return whether theta may go on."""
        bands, s = self._bands, self._settings
        self._series.append(log_amplitudes(x, bands))
        length, count = bands.length * bands.dt, len(self._series)
        if count < max(s.fewest, self._next):
            return False
        self._next = count + 1 + int(s.soon * count)
        summary = summarise(np.array(self._series), self._guides)
        settled = [visit.settled for visit in self._state.visits]
        needed = s.reserve * float(np.quantile(settled, 0.75)) / length if settled else 0.0
        small = bool((summary.error[self._guides] <= self._target).all())
        enough = count >= max(self._least, needed) and summary.settled and small
        if count < self._most and not enough:
            return False
        mean, error = (tuple(map(float, part)) for part in (summary.mean, summary.error))
        self._state.queue.pop(0)
        self._state.visits.append(
            Visit(self._level, mean, error, summary.skip * length, count * length)
        )
        return True

    @property
    def windows(self) -> int:
        """How many windows this rest has."""
        return len(self._series)

    @property
    def visits_left(self) -> int:
        """How many visits are to come, with the first round at random."""
        queue = len(self._state.queue)
        first = len(self._state.visits) + queue <= self._state.staircase
        return queue + self._state.levels * first

    @property
    def _bands(self) -> Bands:
        assert self._state.bands is not None, "look first"
        return self._state.bands

    def _guiding(self) -> list[int]:
        """Return the features that tell how long theta rests."""
        if len(self._state.visits) >= self._state.staircase:
            return [self._feature()]
        each = len(self._bands.edges)  # until then each channel's amplitude at all frequencies
        return [i * each for i in range(len(self._rig.names))]

    def _feature(self) -> int:
        """Return the feature that tells theta best."""
        return self._state.clearest(range(len(self._bands.edges) * len(self._rig.names)))


def beside_cliff(static_map: StaticMap, reached: Sequence[int], level: int) -> bool:
    """Return whether a value is the last good one before a cliff, or between that and beyond.

    ``reached`` holds the numbers of the map's values.
    """
    for side in (1, -1):
        cliff = static_map.cliff(side)
        if cliff is not None:
            inner, outer = reached[cliff.inner], reached[cliff.outer]
            if min(inner, outer) <= level <= max(inner, outer) and level != outer:
                return True
    return False


def from_both_sides(added: Sequence[int]) -> list[int]:
    """Return the way to values that were added, from above and from below.

    >>> from_both_sides([5])
    [6, 5, 4, 5]
    """
    return [level for number in added for level in (number + 1, number, number - 1, number)]
