"""How regularly messages arrive, and how many are lost. Pure: arrays in, figures out.

Steps or stamps show which messages are lost. Without them only the arrival does: a late message is
followed by others that come sooner, a lost one is not. What counts is how far the arrivals have
fallen behind for good:

    behind_i = min over j >= i of (a_j - a_0 - j dt)

which is flat where messages were only late and rises by dt where one is lost. A clock that is a
little slow lets it rise too, but not in jumps; no more are lost than fit into the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.losses import count_losses
from koop_commission.fitness.samples import Samples
from koop_commission.fitness.settings import DEFAULTS
from koop_core.errors import InputError
from koop_node.node.adapter import StepCounter

PARTS = 8  # of the messages, of which a pause spoils a few


class Rhythm(NamedTuple):
    """Rate, jitter and losses of the messages of one topic.

    Attributes
    ----------
    received : int
        Messages received.
    rate : float
        Messages per second, on arrival [1/s].
    interval : float
        Time between two measurements [s], of the rig's own time: the median; of messages without
        stamps the mean if that is nearer to dt, as of those that come in bursts.
    jitter : float
        99 % of the intervals on arrival differ from their median by at most this [s].
    lost : int
        Messages lost.
    source : str
        What shows the losses: ``steps``, ``stamps`` or ``arrival``.
    steady : float
        Messages per second, on arrival [1/s], in most of the time: a pause, after which those that
        waited come at once, does not count.
    """

    received: int
    rate: float
    interval: float
    jitter: float
    lost: int
    source: str
    steady: float

    @property
    def share(self) -> float:
        """Share of the messages sent that were lost."""
        return self.lost / max(self.lost + self.received, 1)


def measure_rhythm(samples: Samples, dt: float, pace: float = 1.0) -> Rhythm:
    """Measure how regularly messages arrive and how many are lost.

    Parameters
    ----------
    samples : Samples
        The messages.
    dt : float
        Time between two measurements [s], of the rig's own time.
    pace : float
        Seconds of the rig's own time per second.

    Raises
    ------
    koop_core.errors.InputError
        If there are too few messages.
    """
    arrival = samples.arrival
    if arrival.size < DEFAULTS.fewest:
        raise InputError(f"{arrival.size} messages arrived, {DEFAULTS.fewest} are needed")
    gaps = np.diff(arrival) * pace
    if samples.has_steps:
        source, lost = "steps", count_losses(np.unique(samples.step)).lost
        clock = np.diff(samples.stamp) if samples.has_stamps else gaps
        interval = float(np.median(clock / np.maximum(np.diff(samples.step), 1)))
    elif samples.has_stamps:
        counter = StepCounter(dt)
        steps = np.array([counter.next(float(value)) for value in samples.stamp], np.int64)
        source, lost = "stamps", count_losses(np.unique(steps)).lost
        interval = float(np.median(np.diff(samples.stamp)))
    else:
        source = "arrival"
        interval = min(float(np.median(gaps)), float(gaps.mean()), key=lambda v: abs(v - dt))
        lost = count_lost_by_arrival(arrival * pace, dt)
    edges = np.linspace(0, arrival.size - 1, PARTS + 1).astype(int)
    return Rhythm(
        received=arrival.size,
        rate=(arrival.size - 1) / max(float(arrival[-1] - arrival[0]), 1e-9),
        interval=interval,
        jitter=float(np.quantile(np.abs(gaps - np.median(gaps)), 0.99)) / pace,
        lost=lost,
        source=source,
        steady=float(np.median(np.diff(edges) / np.maximum(np.diff(arrival[edges]), 1e-9))),
    )


def count_lost_by_arrival(arrival: NDArray[np.float64], dt: float) -> int:
    """Return how many messages of an unstamped source are lost.

    >>> kept = np.delete(np.arange(100) * 0.01, [3, 50, 51])
    >>> count_lost_by_arrival(kept, 0.01)
    3
    """
    behind = arrival - arrival[0] - np.arange(arrival.size) * dt
    kept = np.minimum.accumulate(behind[::-1])[::-1]
    rises = np.diff(kept) / dt
    jumps = int(np.round(rises[rises > DEFAULTS.rise]).sum())
    by_count = round(float(arrival[-1] - arrival[0]) / dt) - (arrival.size - 1)
    return max(min(jumps, by_count), 0)
