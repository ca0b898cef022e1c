"""Takes the messages that wait for subscriptions, in compiled code, into one buffer.

Python does per poll what it would do per message. What DDS carries is kept as it came, damaged or
not; only the step is looked for, where a message of the loop has it.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.losses import LossCounter
from koop_bag.mcap.chunk import BEGIN, CHANNEL, LOG_TIME, PUBLISH_TIME, SIZE
from koop_core.foreign import call
from koop_core.kernels import direct, njit
from koop_core.port import take
from koop_node.node.memory import Memory, address_of, functions

STEP, HAS_STEP = 5, 6
"""Further columns of the table: the step, of 64 bits without a sign, and whether there is one."""
AT_ONCE = 2000
"""Messages taken from one topic before the next one has its turn."""
ROOM = 1 << 18  # [B] at first
MOST = 1 << 24  # [B] beyond which the buffer is given up again


NONE: NDArray[np.int64] = np.empty((0, 7), np.int64)
"""No rows."""


class Rows(NamedTuple):
    """What was taken from a source."""

    table: NDArray[np.int64]
    """Shape (n, 7): the rows of :class:`koop_bag.mcap.chunk.Batch`, with STEP and HAS_STEP; the
    channel is the number of the source."""
    follow: bool
    """Whether each has a step, the next after the last one."""

    def add_to(self, losses: LossCounter) -> None:
        """Count the messages, without those that are damaged."""
        if self.follow and len(self.table):
            losses.add_run(int(self.table[0, STEP]), len(self.table))
        elif len(self.table):
            steps = self.table[self.table[:, HAS_STEP] == 1, STEP]
            losses.add_many(steps.view(np.uint64))


@njit()
def _word(data: NDArray[np.uint8], at: int, count: int) -> int:
    """Read an integer of so many bytes."""
    value = 0
    for i in range(count):
        value |= int(data[at + i]) << (8 * i)
    return value


@njit()
def _find_step(data: NDArray[np.uint8], begin: int, size: int) -> tuple[int, int]:
    """Return the step, after a header whose text is of any length, and whether there is one."""
    if size < 16:
        return 0, 0
    # 4 bytes tell the encoding; alignment counts from there, where stamp and length take 12
    at = 4 + ((12 + _word(data, begin + 12, 4) + 7) & ~7)
    if at + 8 > size:
        return 0, 0
    return _word(data, begin + at, 8), 1


class _Taken(NamedTuple):
    """What was taken; the kernel writes to it."""

    table: NDArray[np.int64]
    """Shape (R, 7): the rows of :class:`koop_bag.mcap.chunk.Batch`, with STEP and HAS_STEP."""
    data: NDArray[np.uint8]
    """Shape (D,): the messages, one after the other."""
    used: NDArray[np.int64]
    """Shape (2,): how much of both is used."""
    ends: NDArray[np.int64]
    """Shape (S, 2): of each source: where its rows end, and whether each of their steps follows on
    the last."""


@njit(nogil=True)
def _drain(
    functions: tuple[int, int],
    handles: NDArray[np.int64],
    start: int,
    now: int,
    message: NDArray[np.int64],
    info: NDArray[np.int64],
    taken: _Taken,
) -> int:
    """Take what waits for the sources from one on; return at which the data are full, or their end.

    The message that did not fit stays where rcl put it: it is the first the next time.
    """
    take_message, copy = functions
    table, data, used, ends = taken
    for source in range(start, handles.size):
        first = ends[source - 1, 0] if source else 0
        while used[0] < first + AT_ONCE:
            if message[1] == 0 and not take(take_message, handles[source], message, info):
                break
            row, begin, size = used[0], used[1], message[1]
            if begin + size > data.size:
                return source
            call(copy, data.ctypes.data + begin, message[0], size, 0)
            message[1] = 0
            sent, received = info[0], info[1]
            if received == 0:  # not every DDS gives the time of reception
                received = now
            step, has_step = _find_step(data, begin, size)
            if row == first:
                ends[source, 1] = has_step and step >= 0
            else:
                # one that was lost and sent again is received after those that waited for it
                received = max(received, table[row - 1, LOG_TIME])
                ends[source, 1] &= has_step and step == table[row - 1, STEP] + 1 and step > 0
            table[row, LOG_TIME], table[row, CHANNEL] = received, source
            table[row, PUBLISH_TIME] = sent
            table[row, BEGIN], table[row, SIZE] = begin, size
            table[row, STEP], table[row, HAS_STEP] = step, has_step
            used[0], used[1] = row + 1, begin + size
        ends[source, 0] = used[0]
    return handles.size


class Drain:
    """Takes messages, which stay until the next are taken."""

    def __init__(self) -> None:
        self._memory = Memory()
        copy = address_of(ctypes.CDLL(None).memcpy)
        self._functions = functions()[1], copy
        self._taken = _Taken(
            NONE,
            np.empty(ROOM, np.uint8),
            np.zeros(2, np.int64),
            np.empty((0, 2), np.int64),
        )
        memory = self._memory
        self._drain = direct(
            _drain, self._functions, np.empty(0, np.int64), 0, 0, memory.message, memory.info,
            self._taken,
        )  # fmt: skip

    @property
    def data(self) -> NDArray[np.uint8]:
        """The messages, one after the other."""
        return self._taken.data

    def take(self, subscriptions: Sequence[Any]) -> list[Rows]:
        """Take what waits for each, at most AT_ONCE."""
        handles = np.array([each.handle.pointer for each in subscriptions], np.int64)
        taken, memory, now = self._taken, self._memory, time.time_ns()
        if len(taken.ends) < len(handles):
            table = np.empty((AT_ONCE * len(handles), 7), np.int64)
            taken = taken._replace(table=table, ends=np.zeros((len(handles), 2), np.int64))
        if taken.data.size > MOST:
            taken = taken._replace(data=np.empty(ROOM, np.uint8))
        taken.used[:] = memory.message[1] = source = 0
        while source < len(handles):
            source = self._drain(
                self._functions, handles, source, now, memory.message, memory.info, taken
            )
            if source < len(handles):
                used = int(taken.used[1])
                data = np.empty(2 * (used + int(memory.message[1])), np.uint8)
                data[:used] = taken.data[:used]
                taken = taken._replace(data=data)
        self._taken = taken
        ends = taken.ends[: len(handles)].tolist()
        begins = [0, *(end for end, _ in ends)]
        return [
            Rows(taken.table[begin:end], bool(follow))
            for begin, (end, follow) in zip(begins, ends, strict=False)
        ]
