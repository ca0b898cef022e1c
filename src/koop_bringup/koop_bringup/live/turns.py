"""Where processes run that work one after the other, as the nodes of a loop in lockstep do."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterable
from contextlib import suppress


def take_turns(pids: Iterable[int], listeners: Iterable[int] = ()) -> None:
    """Let processes share a processor, so that none wakes another processor to hand over its work.

    A processor that sleeps takes longer to wake than a node takes for its step; as batch work, a
    process that is woken waits until the one that woke it sleeps. Where there is one processor
    only, or no Linux, nothing changes.

    Parameters
    ----------
    pids : iterable of int
        Processes, with all their threads.
    listeners : iterable of int
        Processes that hear the others and run beside them: batch work, too.
    """
    if sys.platform != "linux":
        return
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2:
        return
    one = {random.choice(sorted(allowed))}  # several loops do not all want the first one
    for shared, group in ((one, pids), (allowed, listeners)):
        for pid in group:
            _put(pid, shared, os.SCHED_BATCH)


def _put(pid: int, processors: set[int], policy: int) -> None:
    """Give all threads of a process their processors and their kind of work."""
    with suppress(OSError):  # it has ended
        for thread in map(int, os.listdir(f"/proc/{pid}/task")):
            os.sched_setscheduler(thread, policy, os.sched_param(0))
            os.sched_setaffinity(thread, processors)
