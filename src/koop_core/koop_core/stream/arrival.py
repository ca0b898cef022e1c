"""How a message follows on the ones before it. Pure: no ROS, no clock.

Only steps decide, so that a replay at any speed decides the same. ``classify`` is plain Python in
the nodes, one call a message, and is compiled into the loops that answer a million messages.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from koop_core.stream.settings import STREAM


class Arrival(IntEnum):
    """Class of a message: up to JOIN they are processed, up to REPEAT answered."""

    NEXT = 0
    """Follows on the last message, perhaps after a few lost ones."""
    RESUME = 1
    """The same run goes on after a silence."""
    RESTART = 2
    """A run begins: step 0, as the first message or after another run."""
    JOIN = 3
    """A run that is under way: the first message, or the steps went back, but not to 0."""
    REPEAT = 4
    """The same step as the last one: asked again, or duplicated on its way."""
    LATE = 5
    """Was overtaken by a newer message."""
    TOO_OLD = 6
    """Was stale on arrival; it is as if it had never been heard."""


SHORTEST_DT, LONGEST_DT = 1e-6, 1.0  # [s] sampling times of a loop


def timeout_of(dt: float) -> float:
    """Return the age at which an input with a sampling time is stale [s]."""
    return max(STREAM.silence * dt, STREAM.shortest)


class Heard(NamedTuple):
    """State of a stream's classifier."""

    step: int
    """Step of the newest message; -1 before the first."""
    late: int
    """Messages in a row that newer ones had overtaken."""


NOTHING = Heard(-1, 0)


def classify(heard: Heard, step: int, timeout: float, dt: float) -> tuple[Arrival, Heard]:
    """Say what a message is, and return the stream with it.

    After a silence of ``timeout`` [s], in steps of ``dt`` [s], the stream resumes; 0: never. No
    step tells TOO_OLD.
    """
    last = heard.step
    if step == last:
        return Arrival.REPEAT, heard
    if step < last and 0 < step >= last - STREAM.window and heard.late < STREAM.window:
        return Arrival.LATE, Heard(last, heard.late + 1)
    if last >= 0 and step > last:
        arrival = Arrival.RESUME if 0.0 < timeout < (step - last) * dt else Arrival.NEXT
    else:
        arrival = Arrival.RESTART if step == 0 else Arrival.JOIN
    return arrival, Heard(step, 0)
