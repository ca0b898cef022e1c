"""How regularly messages come, and how many are missing. Pure: arrays in, figures out.

Of messages with steps or stamps, those say what is missing. Of others, only their arrival does: a
late message is followed by others that come the sooner, a lost one is not. So what counts is how
far the arrivals have fallen behind for good:

    behind_i = min over j >= i of (a_j - a_0 - j dt)

which is flat where messages were only late and rises by dt where one is missing. A clock that is a
little slow lets it rise too, but not in jumps; there are no more missing than fit into the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_node.node.adapter import StepCounter

NEAR = 0.2  # share of dt within which the usual interval is taken for one period
RISE = 0.6  # periods that a lost message sets the others back by at least
FEWEST = 20  # messages that say something about their rhythm


class Rhythm(NamedTuple):
    """How messages come.

    Attributes
    ----------
    received : int
        Messages that came.
    rate : float
        Of them, on arrival [1/s].
    interval : float
        Usual one (median) between two measurements [s].
    jitter : float
        99 % of the intervals of arrival are off from it by no more than this [s].
    lost : int
        Messages that are missing.
    source : str
        What tells that: ``steps``, ``stamps`` or ``arrival``.
    longest : float
        Longest time without a message [s].
    """

    received: int
    rate: float
    interval: float
    jitter: float
    lost: int
    source: str
    longest: float

    @property
    def share(self) -> float:
        """Of the messages that were sent, the share that is missing."""
        return self.lost / max(self.lost + self.received, 1)


def rhythm(
    arrival: NDArray[np.float64],
    stamp: NDArray[np.float64],
    step: NDArray[np.int64],
    dt: float,
    scale: float = 1.0,
) -> Rhythm:
    """Judge how messages came.

    Parameters
    ----------
    arrival : ndarray, shape (M,)
        When they came [s].
    stamp : ndarray, shape (M,)
        Their stamps [s]; 0 where there is none.
    step : ndarray, shape (M,)
        Their steps; negative where there is none.
    dt : float
        Time between two measurements [s].
    scale : float
        The rig's seconds in one second.

    Raises
    ------
    ValueError
        If there are fewer than 20 messages.
    """
    if arrival.size < FEWEST:
        raise ValueError(f"{arrival.size} messages came, {FEWEST} are needed")
    gaps = np.diff(arrival) * scale
    if (step >= 0).all() and step[-1] > step[0]:
        source, lost = "steps", _missing(step)
        moved = np.maximum(np.diff(step), 1)
        clock = np.diff(stamp) if (stamp > 0.0).all() else gaps
        interval = float(np.median(clock / moved))
    elif (stamp > 0.0).all() and stamp[-1] > stamp[0]:
        counter = StepCounter(dt)
        steps = np.array([counter.next(float(value)) for value in stamp], np.int64)
        source, lost, interval = "stamps", _missing(steps), float(np.median(np.diff(stamp)))
    else:
        source, interval = "arrival", float(np.median(gaps))
        lost = lost_by_arrival(arrival * scale, dt)
    return Rhythm(
        arrival.size,
        (arrival.size - 1) / max(float(arrival[-1] - arrival[0]), 1e-9),
        interval,
        float(np.quantile(np.abs(gaps - np.median(gaps)), 0.99)) / scale,
        lost,
        source,
        float(gaps.max()) / scale,
    )


def lost_by_arrival(arrival: NDArray[np.float64], dt: float) -> int:
    """Return how many messages of an unstamped source are missing.

    >>> kept = np.delete(np.arange(100) * 0.01, [3, 50, 51])
    >>> lost_by_arrival(kept, 0.01)
    3
    """
    behind = arrival - arrival[0] - np.arange(arrival.size) * dt
    kept = np.minimum.accumulate(behind[::-1])[::-1]
    rises = np.diff(kept) / dt
    jumps = int(np.round(rises[rises > RISE]).sum())
    by_count = round(float(arrival[-1] - arrival[0]) / dt) - (arrival.size - 1)
    return max(min(jumps, by_count), 0)


def _missing(step: NDArray[np.int64]) -> int:
    ahead = np.diff(np.unique(step))
    return int((ahead[ahead < 1_000_000] - 1).sum())  # further is another sender, or another clock
