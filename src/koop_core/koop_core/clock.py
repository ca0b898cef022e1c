"""The clocks of the system in compiled code, by libc. Pure."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.foreign import call, libc
from koop_core.kernels import njit

STEADY, SYSTEM = time.CLOCK_MONOTONIC, time.CLOCK_REALTIME


class Clock(NamedTuple):
    """How compiled code reads a clock."""

    function: int
    """Address of libc's clock_gettime."""
    memory: NDArray[np.int64]
    """Shape (2,): what it told last [s, ns]."""


@njit()
def steady(clock: Clock) -> float:
    """Return the steady time [s], as time.monotonic() does."""
    call(clock.function, STEADY, clock.memory.ctypes.data, 0, 0)
    return clock.memory[0] + clock.memory[1] * 1e-9


@njit()
def system(clock: Clock) -> int:
    """Return the system's time [ns], as time.time_ns() does."""
    call(clock.function, SYSTEM, clock.memory.ctypes.data, 0, 0)
    return int(clock.memory[0] * 1_000_000_000 + clock.memory[1])


def make_clock() -> Clock:
    """Return a clock with a memory of its own."""
    return Clock(libc("clock_gettime"), np.zeros(2, np.int64))
