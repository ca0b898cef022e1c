"""How compiled code goes on with the loops of a process until Python is due, by libc. Pure.

A table, :class:`Turns`, has what Python has lent of each loop, and when it is due. The code runs
the loops that are due, and sleeps until the next one is or has a message.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.borrowed import borrowed, is_of, load, store
from koop_core.clock import Clock, steady
from koop_core.foreign import call
from koop_core.kernels import Kernel, njit
from koop_core.port import IDLE, MORE

READABLE = 1 << 32  # the events of a pollfd, above its descriptor: POLLIN
ROOM = 1 << 13  # [B] of what is lent of a loop
NOW, NEVER = -math.inf, math.inf
NEAR = 0.5e-3  # [s] within which a tick comes before Python, which takes as long
Reasons = NDArray[np.int64]
"""Shape (S,): why each stage of a loop has stopped, see :mod:`koop_core.port`."""
Memory = NDArray[np.uint8]
"""Shape (ROOM,): what is lent of a loop."""


class Wakeup(NamedTuple):
    """What wakes a thread."""

    clock: Clock
    """Tells when the code looked last."""
    ppoll: int
    read: int
    """Addresses of libc's functions."""
    epoll: int
    """Descriptor that tells whether there is anything new for the thread."""
    until: float
    """Steady time [s] at which Python has something to do."""
    memory: NDArray[np.int64]
    """Shape (4,): a pollfd, how long to wait [s, ns], and what is read."""


class Turns(NamedTuple):
    """The L loops of a process, with up to S stages each."""

    memory: NDArray[np.uint8]
    """Shape (L, ROOM): what is lent."""
    due: NDArray[np.float64]
    """Shape (L,): steady time [s] at which a loop has something to do without a message."""
    lent: NDArray[np.bool_]
    """Shape (L,)."""
    reasons: NDArray[np.int64]
    """Shape (L, S)."""
    descriptors: NDArray[np.int64]
    """Shape (L, S): those of the epoll to which DDS writes that there are messages; -1: none."""


def make_turns(loops: int, stages: int) -> Turns:
    """Return a table of loops of which nothing is lent."""
    return Turns(
        np.zeros((loops, ROOM), np.uint8), np.full(loops, NEVER), np.zeros(loops, np.bool_),
        np.zeros((loops, stages), np.int64), np.full((loops, stages), -1),
    )  # fmt: skip


@njit()
def put(turns: Turns, i: int, loop: Any, kind: Any) -> bool:
    """Lend a loop, whose owner keeps it, if it is of a type; return whether it is."""
    if not is_of(loop, kind):
        return False
    store(turns.memory[i], 0, loop)
    return True


@njit()
def get(turns: Turns, i: int, kind: Any) -> Any:
    """Return what has changed of a loop, of this type, since it was lent."""
    return load(turns.memory[i], 0, kind).progress


@njit()
def is_told(wakeup: Wakeup, descriptors: NDArray[np.int64]) -> bool:
    """Return whether there are messages for stages, and forget it."""
    told = False
    for descriptor in descriptors:  # of an eventfd: to read it is to clear it
        if descriptor >= 0:
            got = call(wakeup.read, descriptor, wakeup.memory[3:].ctypes.data, 8, 0)
            told = told or got > 0
    return told


@njit()
def wait(wakeup: Wakeup, turns: Turns) -> bool:
    """Sleep until a loop is due or has messages; return False where it is Python's turn."""
    memory, until, due = wakeup.memory, wakeup.until, NEVER
    for i in range(turns.due.size):
        if turns.lent[i]:
            due = min(due, turns.due[i])
    if until < due < until + NEAR:
        until = due
    left = min(until, due) - steady(wakeup.clock)
    if left <= 0.0:
        return bool(due <= until)
    memory[0] = wakeup.epoll | READABLE
    memory[1] = int(left)
    memory[2] = int((left - memory[1]) * 1e9)
    if call(wakeup.ppoll, memory.ctypes.data, 1, memory[1:].ctypes.data, 0) == 0:
        return bool(due <= until)
    found = False
    for i in range(turns.due.size):
        if turns.lent[i] and is_told(wakeup, turns.descriptors[i]):
            turns.due[i], found = NOW, True
    return found


def make_run(go_on: Kernel) -> Kernel:
    """Return the kernel that runs the loops of a process.

    ``go_on(most, memory, kind, reasons)`` goes on with one, a ``Loop`` of that type in that memory,
    until it has a reason to stop, at most so many messages, and returns when it is due. A whole
    loop is never an argument: thousands of them would take minutes to compile. No stage imports
    this module: whoever compiles locks modules, from here to the stage's.
    """

    @njit(nogil=True)
    def run(most: int, wakeup: Wakeup, table: Turns, kind: Any) -> None:
        turns, going = borrowed(table), True
        while going:
            now = steady(wakeup.clock)
            for i in range(turns.due.size):
                if not turns.lent[i] or turns.due[i] > now:
                    continue
                memory, reasons = turns.memory[i], turns.reasons[i]
                due = go_on(most, memory, kind, reasons)
                while reasons.max() == IDLE and is_told(wakeup, turns.descriptors[i]):
                    due = go_on(most, memory, kind, reasons)
                turns.due[i] = due if reasons.max() == IDLE else NOW
                going = going and reasons.max() == IDLE
            going = going and wait(wakeup, turns)

    return run


def alone(answer_next: Kernel, due: Kernel) -> Kernel:
    """Return ``go_on`` of :func:`make_run` for a stage by itself, which is due at a time [s]."""

    @njit()
    def go_on(most: int, memory: Memory, kind: Any, reasons: Reasons) -> float:
        loop = load(memory, 0, kind)
        reason, progress, stage = MORE, loop.progress[0], loop.stages[0]
        for _ in range(most):
            reason, progress = answer_next(stage, progress)
            if reason != MORE:
                break
        reasons[0] = reason
        store(memory, 0, Loop(loop.stages, (progress,)))
        at: float = due(progress)
        return at

    return go_on


class Loop(NamedTuple):
    """What is lent of a loop, by stage."""

    stages: Any
    """What stays the same."""
    progress: Any
    """What changes."""


@njit()
def never(progress: Any) -> float:
    """Return when a stage is due that only answers messages."""
    return NEVER
