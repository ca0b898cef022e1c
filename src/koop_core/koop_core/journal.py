"""What the nodes of a process publish, in memory that they share with the recorder. Pure.

A reader in another process costs the publisher of a small message more than all else that is done
with it: the middleware copies it and wakes who waits. Here it is copied, and found by who looks. A
process writes, by one thread, and another reads; neither waits for the other, and what one has
written the other reads also after its end.
"""

from __future__ import annotations

import mmap
import os
import time
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_core.clock import Clock, system
from koop_core.foreign import call, libc
from koop_core.kernels import njit

PATH = "KOOP_JOURNAL"
"""In the environment of a process: its journal."""
BYTES = 1 << 23
TOPICS = 16  # most of them
ENTRY = 512  # [B] of a topic: its name, type and node
HEAD = 3  # words before a message: size [B], number of its topic, when it was published [ns]
WRITTEN, READ, COUNT, FOLLOWED = 0, 8, 16, 24
"""Words: how many were written and read, of all; how many topics; which the reader follows."""
_NAMES = FOLLOWED + TOPICS
FIRST = _NAMES + (TOPICS + 1) * ENTRY // 8
"""Word at which the messages begin."""
ROOM = BYTES // 8 - FIRST


class Place(NamedTuple):
    """Where compiled code writes the messages of a topic."""

    words: NDArray[np.int64]
    """Shape (BYTES / 8,): the journal; (1,): there is none."""
    number: int
    clock: int
    copy: int
    """Addresses of libc's clock_gettime and memcpy."""


NOWHERE = Place(np.zeros(1, np.int64), 0, 0, 0)


@njit()
def append(place: Place, address: int, size: int) -> bool:
    """Write a message of so many bytes from an address; return False if there is no room."""
    words = place.words
    if words.size == 1:
        return False
    written = words[WRITTEN]
    length = HEAD + (size + 7) // 8
    at = written % ROOM
    skipped = ROOM - at if at + length > ROOM else 0
    if written + skipped + length - words[READ] > ROOM:
        return False
    if skipped:
        words[FIRST + at] = -1
        at = 0
    begin = FIRST + at
    words[begin] = size
    words[begin + 2] = system(Clock(place.clock, words[begin + 1 :]))
    words[begin + 1] = place.number
    call(place.copy, words[begin + HEAD :].ctypes.data, address, size, 0)
    words[WRITTEN] = written + skipped + length  # last: what the reader sees is whole
    return True


class Topic(NamedTuple):
    """A topic of a journal: full name, message type, and full name of the node that publishes."""

    name: str
    type: str
    node: str


class Journal:
    """A journal, as one of its two processes sees it; ``path`` as :func:`make_journal` tells."""

    def __init__(self, path: str) -> None:
        with open(path, "r+b") as file:
            self.words = np.frombuffer(mmap.mmap(file.fileno(), BYTES), np.int64)

    def place(self, topic: Topic) -> Place:
        """Return where the messages of a topic are written; NOWHERE if there are too many."""
        entry, topics = " ".join(topic), self.topics()
        number = topics.index(topic) if topic in topics else len(topics)
        if number == TOPICS or len(entry) > ENTRY:
            return NOWHERE
        self._write(number, entry)
        self.words[COUNT] = max(number + 1, self.words[COUNT])
        return Place(self.words, number, libc("clock_gettime"), libc("memcpy"))

    def topics(self) -> list[Topic]:
        """Return the topics, by number."""
        return [Topic(*self._text(number).split(" ")) for number in range(self.words[COUNT])]

    def follow(self, number: int, reader: str) -> None:
        """Say that a node reads what comes of a topic."""
        self._write(TOPICS, reader)
        self.words[FOLLOWED + number] = 1

    def readers(self) -> dict[str, str]:
        """Return who reads which topic, by its name."""
        reader, topics = self._text(TOPICS), self.topics()
        return {t.name: reader for n, t in enumerate(topics) if self.words[FOLLOWED + n]}

    def _text(self, number: int) -> str:
        begin = _NAMES * 8 + number * ENTRY
        return self.words.view(np.uint8)[begin : begin + ENTRY].tobytes().rstrip(b"\0").decode()

    def _write(self, number: int, text: str) -> None:
        begin, data = _NAMES * 8 + number * ENTRY, np.frombuffer(text.encode(), np.uint8)
        self.words.view(np.uint8)[begin : begin + len(data)] = data

    def read_within(self, patience: float) -> bool:
        """Return whether a reader leaves half of the room, or does within a time [s]."""
        deadline = time.monotonic() + patience
        followed = self.words[FOLLOWED:_NAMES].any()
        while followed and self.words[WRITTEN] - self.words[READ] > ROOM // 2:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.001)
        return True


def journal_of_process() -> Journal | None:
    """Return the journal of this process, if it has one that it may open."""
    path = os.environ.get(PATH)
    return _open(path) if path else None


@cache
def _open(path: str) -> Journal | None:
    try:
        return Journal(path)
    except OSError:  # who made it has ended, or has capabilities: nobody may open what it has
        return None


def make_journal() -> tuple[int, dict[str, str]]:
    """Return the descriptor of a new journal, and what tells processes of it: their environment.

    It lasts as long as this descriptor or a process that has opened it.
    """
    descriptor = os.memfd_create("koop_journal")
    os.ftruncate(descriptor, BYTES)
    return descriptor, {PATH: f"/proc/{os.getpid()}/fd/{descriptor}"}
