"""What an excitation decides: what is heard first, where theta goes, when it goes on. Pure: no ROS.

:class:`Survey` is told what the rig said, window by window, and says what is next; who moves theta
and who listens is another's, be it ``koop excite`` with a rig or a study with a simulated one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.errors import InputError
from koop_tune.excitation import staircase
from koop_tune.excitation.channels import lines, listens
from koop_tune.excitation.features import Bands, bands, bridged, features, window_length
from koop_tune.excitation.progress import Progress
from koop_tune.excitation.staircase import Visit
from koop_tune.rig.rig_file import RigFile
from koop_tune.rig_model.stays import Scale

WINDOW = 4.0  # periods of the strongest oscillation
SLOWEST = 2.0  # periods of the slowest one, where that is longer
LISTEN = 40.0  # windows' worth of periods is not known before: periods that are listened to first
SHORTEST, LONGEST = 3.0, 120.0  # [s] of that
LONGEST_SHARE = 0.02  # of the time that all may take, where that is longer
SOON = 0.02  # of the windows of a stay, after which it is judged again
MOST_SHARE = 0.15  # of the time, that theta stays at one value at most


class Heard(NamedTuple):
    """Periods of the oscillations before theta moves [s], the strongest and the slowest."""

    strongest: float
    slowest: float


class Survey:
    """An excitation's decisions.

    Parameters
    ----------
    rig : RigFile
        The rig.
    state : Progress
        What was done; it grows.
    """

    def __init__(self, rig: RigFile, state: Progress) -> None:
        self._rig = rig
        self._state = state
        self._level = self._next = 0
        self._least = self._most = staircase.FEWEST
        self._guide: list[int] = []
        self._target = staircase.FLOOR
        self._series: list[NDArray[np.float64]] = []

    # -- before theta moves ---------------------------------------------------------------------

    def listens(self, x: NDArray[np.float64]) -> bool:
        """Return whether more must be heard than x, shape (M, n), before theta moves."""
        longest = max(LONGEST, LONGEST_SHARE * self._rig.time)
        return listens(x, self._rig.dt, SHORTEST, LISTEN, longest)

    def look(self, x: NDArray[np.float64]) -> Heard:
        """Choose the windows from what was heard, shape (M, n).

        Raises
        ------
        koop_core.errors.InputError
            If no channel moves.
        """
        dt, x = self._rig.dt, bridged(x)
        found = [line for column in x.T for line in lines(column, dt)]
        if not found:
            raise InputError("no channel moves: dead sensors, or other fields")
        strongest = 1.0 / max(found, key=lambda line: line.share).frequency
        slowest = 1.0 / min(line.frequency for line in found)
        window = max(WINDOW * strongest, SLOWEST * slowest)
        length = min(window_length(window, 1.0, dt), x.shape[0])
        self._state.how = bands(x, length, dt)
        return Heard(strongest, slowest)

    # -- where theta goes -----------------------------------------------------------------------

    def next_value(self) -> float | None:
        """Return where theta goes next; None once the static map is known well enough."""
        state = self._state
        if not state.queue:
            state.queue = self._next_round()
            if not state.queue:
                state.queue = staircase.from_both_sides(self._add_values())
            if not state.queue:
                state.done = True
                return None
        return state.values[state.queue[0]]

    def _next_round(self) -> list[int]:
        state = self._state
        return staircase.next_round(
            state.visits, self._feature(), state.seed, self._sense, len(state.values)
        )

    def _add_values(self) -> list[int]:
        """Add values of theta beside the best one where the map is steep; return their numbers."""
        state, rig = self._state, self._rig
        scale = Scale(rig.theta_min, rig.theta_max)
        at = scale.u(np.array(state.values)).tolist()
        found = staircase.between(state.visits, self._feature(), self._sense, at)
        for level, u in found:
            state.add(level, scale.theta_at(u))
        levels = [level for level, _ in found]
        return [level + sum(other < level for other in levels) for level in levels]

    def arrive(self, elapsed: float) -> None:
        """Begin a stay at that value, after so much of the rig's time [s]."""
        state, how = self._state, self._how
        self._level, self._series, self._next = state.queue[0], [], 0
        self._guide = self._guiding()
        count, guide = len(state.values), self._guide[0]
        slow = staircase.beside_cliff(state.visits, guide, self._sense, self._level, count)
        self._least = staircase.LINGER if slow else staircase.FEWEST
        points = staircase.static_map(state.visits, guide, count)
        self._target = staircase.target_error(points)
        left = max(self._rig.time - elapsed, 0.0)
        fair = min(MOST_SHARE * self._rig.time, 2.0 * left / self.visits_left)
        self._most = max(staircase.FEWEST, int(fair / (how.length * how.dt)))
        self._least = min(self._least, self._most)

    def take(self, x: NDArray[np.float64]) -> bool:
        """Take a window of samples, shape (length, n); return whether theta may go on."""
        how, state = self._how, self._state
        self._series.append(features(x, how))
        length, count = how.length * how.dt, len(self._series)
        if count < max(staircase.FEWEST, self._next):
            return False
        self._next = count + 1 + int(SOON * count)
        judged = staircase.judge(np.array(self._series), self._guide)
        seen = [visit.settled for visit in state.visits]
        if staircase.stays(
            judged, count, length, self._guide, self._target, seen, self._least, self._most
        ):
            return False
        state.queue.pop(0)
        state.visits.append(
            Visit(
                self._level,
                tuple(map(float, judged.mean)),
                tuple(map(float, judged.error)),
                judged.skip * length,
                count * length,
            )
        )
        return True

    @property
    def windows(self) -> int:
        """How many windows this stay has."""
        return len(self._series)

    @property
    def visits_left(self) -> int:
        """How many stays are to come, with the first round at random."""
        queue = len(self._state.queue)
        first = len(self._state.visits) + queue <= len(staircase.passes(True))
        return queue + staircase.LEVELS * first

    @property
    def _how(self) -> Bands:
        assert self._state.how is not None, "look first"
        return self._state.how

    def _guiding(self) -> list[int]:
        """Return the features that tell how long theta stays."""
        if len(self._state.visits) >= len(staircase.passes(True)):
            return [self._feature()]
        each = len(self._how.edges)  # until then each channel's amplitude at all frequencies
        return [i * each for i in range(len(self._rig.names))]

    def _feature(self) -> int:
        """Return the feature that tells theta best."""
        every = len(self._how.edges) * len(self._rig.names)
        return staircase.clearest(self._state.visits, range(every), len(self._state.values))

    @property
    def _sense(self) -> float:
        return 1.0 if self._rig.objective == "minimise" else -1.0
