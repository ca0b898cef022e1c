"""Takes the messages that wait for subscriptions, in compiled code, into one buffer.

Python does per poll what it would do per message. What DDS carries is kept as it came, damaged or
not; only the step is looked for, where a message of the loop has it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.losses import LossCounter
from koop_bag.mcap.chunk import BEGIN, CHANNEL, LOG_TIME, PUBLISH_TIME, SIZE
from koop_core.foreign import call, libc
from koop_core.journal import FIRST, HEAD, READ, TOPICS, WRITTEN, Journal
from koop_core.journal import ROOM as JOURNAL_ROOM
from koop_core.kernels import direct, njit
from koop_core.port import take
from koop_node.node.memory import Memory, functions

STEP, HAS_STEP = 5, 6
"""Further columns of the table: the step, of 64 bits without a sign, and whether there is one."""
AT_ONCE = 4000
"""Messages taken from one topic before the next one has its turn."""
ROOM = 1 << 18  # [B] at first
MOST = 1 << 24  # [B] beyond which the buffer is given up again


NO_IDS: NDArray[np.int64] = np.empty((0, 2), np.int64)
"""No publishers."""


Rows = NDArray[np.int64]
"""What was taken from a source, shape (n, 7): the rows of :class:`koop_bag.mcap.chunk.Batch`, with
STEP and HAS_STEP; the channel is the number of the source."""
NONE: Rows = np.empty((0, 7), np.int64)
"""No rows."""


def count_steps(rows: Rows, losses: LossCounter) -> None:
    """Count the messages, without those that are damaged."""
    losses.add_many(rows[rows[:, HAS_STEP] == 1, STEP].view(np.uint64))


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
    """Shape (S,): where the rows of each source end."""


@njit()
def _is_one_of(publishers: NDArray[np.int64], info: NDArray[np.int64]) -> bool:
    """Return whether a message comes from one of some publishers, shape (P, 2): the ids' words."""
    for i in range(publishers.shape[0]):
        if info[5] == publishers[i, 0] and info[6] == publishers[i, 1]:
            return True
    return False


@njit(nogil=True)
def _drain(
    functions: tuple[int, int],
    handles: NDArray[np.int64],
    own: NDArray[np.int64],
    start: int,
    now: int,
    message: NDArray[np.int64],
    info: NDArray[np.int64],
    taken: _Taken,
) -> int:
    """Take what waits for the sources from one on; return at which the data are full, or their end.

    Left out is what publishers have sent that write to the journal, by their ids. The message that
    did not fit stays where rcl put it: it is the first the next time.
    """
    take_message, copy = functions
    table, data, used, ends = taken
    for source in range(start, handles.size):
        first = ends[source - 1] if source else 0
        while used[0] < first + AT_ONCE and handles[source]:
            if message[1] == 0 and not take(take_message, handles[source], message, info):
                break
            if _is_one_of(own, info):
                message[1] = 0
                continue
            row, begin, size = used[0], used[1], message[1]
            if begin + size > data.size:
                return source
            call(copy, data.ctypes.data + begin, message[0], size, 0)
            message[1] = 0
            sent, received = info[0], info[1]
            if received == 0:  # not every DDS gives the time of reception
                received = now
            step, has_step = _find_step(data, begin, size)
            if row > first:  # one that was lost and sent again comes after those that waited for it
                received = max(received, table[row - 1, LOG_TIME])
            table[row, LOG_TIME], table[row, CHANNEL] = received, source
            table[row, PUBLISH_TIME] = sent
            table[row, BEGIN], table[row, SIZE] = begin, size
            table[row, STEP], table[row, HAS_STEP] = step, has_step
            used[0], used[1] = row + 1, begin + size
        ends[source] = used[0]
    return handles.size


@njit(nogil=True)
def _read(
    words: NDArray[np.int64], until: int, sources: NDArray[np.int64], copy: int, taken: _Taken
) -> None:
    """Read a journal up to a word; ``sources`` are those of its topics, -1: none."""
    table, data, used, _ = taken
    read = words[READ]
    while read < until and used[0] < table.shape[0]:
        at = FIRST + read % JOURNAL_ROOM
        size = words[at]
        if size < 0:
            read += JOURNAL_ROOM - read % JOURNAL_ROOM
            continue
        source = sources[words[at + 1]]
        if source >= 0:
            row, begin = used
            call(copy, data.ctypes.data + begin, words[at + HEAD :].ctypes.data, size, 0)
            step, has_step = _find_step(data, begin, size)
            table[row, LOG_TIME] = table[row, PUBLISH_TIME] = words[at + 2]
            table[row, CHANNEL], table[row, BEGIN], table[row, SIZE] = source, begin, size
            table[row, STEP], table[row, HAS_STEP] = step, has_step
            used[0], used[1] = row + 1, begin + size
        read += HEAD + (size + 7) // 8
    words[READ] = read


class Drain:
    """Takes messages, which stay until the next are taken; also those of a journal."""

    def __init__(self, journal: Journal | None = None) -> None:
        self._journal = journal
        self._memory = Memory()
        copy = libc("memcpy")
        self._functions = functions()[1], copy
        self._taken = _Taken(
            NONE,
            np.empty(ROOM, np.uint8),
            np.zeros(2, np.int64),
            np.empty(0, np.int64),
        )
        memory = self._memory
        self._drain = direct(
            _drain, self._functions, np.empty(0, np.int64), NO_IDS, 0, 0, memory.message,
            memory.info, self._taken,
        )  # fmt: skip
        if journal is not None:
            sources = np.full(TOPICS, -1)
            self._read = direct(_read, journal.words, 0, sources, copy, self._taken)

    @property
    def data(self) -> NDArray[np.uint8]:
        """The messages, one after the other."""
        return self._taken.data

    def take(self, sources: Sequence[Any], own: NDArray[np.int64] = NO_IDS) -> list[Rows]:
        """Take what waits for each subscription, or number of a topic of the journal.

        That is at most AT_ONCE of each on average. Left out is what some publishers have sent,
        whose ids have the shape (P, 2).
        """
        numbers: NDArray[np.int64] = np.full(TOPICS, -1)
        for source, each in enumerate(sources):
            if isinstance(each, int):
                numbers[each] = source
        handles = np.array(
            [0 if isinstance(each, int) else each.handle.pointer for each in sources], np.int64
        )
        taken, memory, now = self._taken, self._memory, time.time_ns()
        if len(taken.ends) < len(handles):
            table = np.empty((AT_ONCE * len(handles), 7), np.int64)
            taken = taken._replace(table=table, ends=np.zeros(len(handles), np.int64))
        if taken.data.size > MOST:
            taken = taken._replace(data=np.empty(ROOM, np.uint8))
        taken.used[:] = memory.message[1] = source = 0
        while source < len(handles):
            source = self._drain(
                self._functions, handles, own, source, now, memory.message, memory.info, taken
            )
            if source < len(handles):
                taken = _grow(taken, 2 * int(memory.message[1]))
        ends = taken.ends[: len(handles)].tolist()
        rows = [taken.table[begin:end] for begin, end in pairwise([0, *ends])]
        if self._journal is not None:
            words, begin = self._journal.words, int(taken.used[0])
            until = int(words[WRITTEN])
            taken = _grow(taken, 8 * (until - int(words[READ])))
            self._read(words, until, numbers, self._functions[1], taken)
            read = taken.table[begin : taken.used[0]]
            for source in numbers[numbers >= 0]:
                rows[source] = read[read[:, CHANNEL] == source]
        self._taken = taken
        return rows


def _grow(taken: _Taken, size: int) -> _Taken:
    """Return it with room for so many bytes more."""
    used = int(taken.used[1])
    if used + size <= taken.data.size:
        return taken
    data = np.empty(2 * used + size, np.uint8)
    data[:used] = taken.data[:used]
    return taken._replace(data=data)
