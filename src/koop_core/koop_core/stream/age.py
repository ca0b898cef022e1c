"""How old a message is on arrival, whatever the clock of the host that wrote it. Pure: no ROS.

The time from writing to arrival, on two clocks, is the message's age plus the unknown difference of
the clocks. The smallest such delay of late stands for no age at all; what is above it is the age.

A clock that is set back, or drifts, must not make all messages old for ever. So the smallest delay
may rise, but only to what two periods of unbroken arrivals agree on. Kept messages that arrive
after a cut do not look like that: their delays fall while they drain, or there are gaps.

``age`` is plain Python in the nodes, one call a message, and is compiled into their stages.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from koop_core.stream.settings import STREAM


class Clocks(NamedTuple):
    """What is known of the clock of one writer: delays and times of arrival [s]."""

    best: float
    """The smallest delay."""
    low: float
    low_before: float
    """The smallest of this period and of the one before."""
    end: float
    """Of this period."""
    last: float
    """Arrival of the last message."""


UNKNOWN = Clocks(math.inf, math.inf, math.inf, -math.inf, math.nan)
"""The clock of another writer."""


def age(clocks: Clocks, written: float, now: float) -> tuple[float, Clocks]:
    """Return a message's age [s]; it was written on its writer's clock, and arrives ``now``."""
    best, low, low_before, end, last = clocks
    delay = now - written
    if now - last > STREAM.gap:
        low = low_before = math.inf
        end = now + STREAM.period
    elif now >= end:
        if low > low_before - STREAM.fall:
            best = min(low, low_before)
        low_before, low = low, math.inf
        end = now + STREAM.period
    low, best = min(low, delay), min(best, delay)
    return delay - best, Clocks(best, low, low_before, end, now)
