"""How compiled code waits for its next message, until Python is due, by libc. Pure."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed
from koop_core.foreign import call
from koop_core.kernels import Kernel, njit
from koop_core.port import IDLE, MORE

STEADY = time.CLOCK_MONOTONIC


class Wakeup(NamedTuple):
    """What wakes a thread."""

    clock: int
    epoll_wait: int
    read: int
    """Addresses of libc's clock_gettime, epoll_wait and read."""
    epoll: int
    """Descriptor that tells whether there is anything new for the thread."""
    descriptors: NDArray[np.int64]
    """Shape (S,): those of it to which DDS writes that there are messages for the code."""
    until: float
    """Steady time [s] at which Python has something to do."""
    memory: NDArray[np.int64]
    """Shape (4,): the steady time at which the code waited last [s, ns]; what libc writes."""


@njit()
def wait(wakeup: Wakeup) -> int:
    """Sleep until there are messages for the code: MORE; IDLE where it is Python's turn.

    Epoll's time is in whole milliseconds: the rest is Python's to wait for.
    """
    memory = wakeup.memory
    call(wakeup.clock, STEADY, memory.ctypes.data, 0, 0)
    left = int((wakeup.until - (memory[0] + memory[1] * 1e-9)) * 1e3)
    if left <= 0:
        return IDLE
    call(wakeup.epoll_wait, wakeup.epoll, memory[2:].ctypes.data, 1, left)
    found = IDLE
    for descriptor in wakeup.descriptors:  # of an eventfd: to read it is to clear it
        if call(wakeup.read, descriptor, memory[2:].ctypes.data, 8, 0) > 0:
            found = MORE
    return found


def alone(answer_next: Kernel) -> Kernel:
    """Return the kernel of :class:`koop_node.node.stages.Stages` for a stage by itself.

    No stage imports this module: whoever compiles locks modules, from here to the stage's.
    """

    @njit(nogil=True)
    def answer(most: int, wakeup: Wakeup, stage: Any, progress: Any) -> Any:
        reason, lent = MORE, borrowed(stage)
        for _ in range(most):
            reason, progress = answer_next(lent, progress)
            if reason == IDLE:
                reason = wait(wakeup)
            if reason != MORE:
                break
        return ((reason, progress),)

    return answer
