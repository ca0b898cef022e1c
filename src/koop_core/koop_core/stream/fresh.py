"""Whether compiled code may answer a message: what of it is not too old."""

from __future__ import annotations

from typing import NamedTuple

from koop_core.clock import Clock, steady
from koop_core.kernels import njit
from koop_core.port import Port
from koop_core.stream import age as ages
from koop_core.stream.age import Clocks

age = njit()(ages.age)


class Freshness(NamedTuple):
    """What decides it."""

    lockstep: bool
    """Whether the source waits for the answer, so that age does not matter."""
    timeout: float
    """Age of a message [s] above which it is not answered; 0: never."""
    clock: Clock


@njit()
def is_fresh(fresh: Freshness, port: Port, at: int, clocks: Clocks) -> tuple[bool, Clocks]:
    """Return whether the message may be answered, whose flag 'lockstep' is the port's value."""
    if (port.data[port.at[at]] == 1) != fresh.lockstep:
        return False, clocks
    if fresh.lockstep:
        return True, clocks
    old, clocks = age(clocks, port.info[0] * 1e-9, steady(fresh.clock))
    return not 0.0 < fresh.timeout < old, clocks
