"""What a process of nodes clears away, and when: between two ticks, not in one.

A full collection of Python's garbage looks at every object there is, some 300 000 once rclpy and
numba are imported: tens of milliseconds, whenever enough new objects have come together. What is
there once the nodes run stays to the end, so it is taken out of the collection, without a look:
imports leave some 400 objects as garbage. What is made later is looked through once a second, while
no timer is due.
"""

from __future__ import annotations

import ctypes
import gc
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PERIOD = 1.0  # [s] between two collections
LONGEST = 10.0  # [s] that one is put off because there is no time
ROOM = 0.002  # [s] until the next timer that a collection needs
COMPILER = "libllvmlite"
_MADV_DONTNEED = 4  # asm-generic/mman-common.h


class Housekeeping:
    """Garbage of a process, collected when there is time; ``now`` is a steady time [s]."""

    def __init__(self, now: float) -> None:
        self._next = now + PERIOD
        gc.disable()
        self.settle()

    def settle(self) -> None:
        """Take what is there out of the collection."""
        gc.freeze()

    def tidy(self, now: float, room: float) -> None:
        """Collect if it is time and there is room until the next timer [s]."""
        if now >= self._next and (room >= ROOM or now >= self._next + LONGEST):
            gc.collect()
            self._next = now + PERIOD

    def end(self) -> None:
        """Leave Python as it was."""
        gc.unfreeze()
        gc.enable()


def release_compiler() -> None:
    """Let go of the pages of LLVM that loading the kernels has touched.

    Some 60 MB of every process, of a library of 130 MB, that no tick needs. They stay in the
    system's page cache: what is called again is mapped again.
    """
    for start, end in _compiler():
        ctypes.CDLL(None).madvise(
            ctypes.c_void_p(start), ctypes.c_size_t(end - start), _MADV_DONTNEED
        )


@cache
def _compiler() -> list[tuple[int, int]]:
    """Return where the compiler is, which does not change once it is there."""
    try:
        return list(clean_mappings(Path("/proc/self/smaps").read_text(), COMPILER))
    except OSError:  # not Linux
        return []


def clean_mappings(maps: str, library: str) -> Iterator[tuple[int, int]]:
    """Yield begin and end of the mappings in ``/proc/PID/smaps`` that are as a library's file."""
    for block in re.split(r"\n(?=[0-9a-f]+-[0-9a-f]+ )", maps):
        head, _, rest = block.partition("\n")
        span, permissions, *_, path = head.split()
        if library not in path.rpartition("/")[2] or "w" in permissions:
            continue
        changed = re.findall(r"^(?:Anonymous|Private_Dirty|Shared_Dirty): +(\d+) kB", rest, re.M)
        if changed and not any(int(size) for size in changed):  # else it was relocated
            start, end = span.split("-")
            yield int(start, 16), int(end, 16)
