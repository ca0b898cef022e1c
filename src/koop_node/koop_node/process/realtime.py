"""What an operating system can do for a process that must be in time. Pure: no ROS.

Each is done where it is permitted; where it isn't, the process goes on without, and says which
right it lacks. Which processors it runs on is for ``taskset``, or the service manager, to say.
"""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Callable

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # asm-generic/mman.h
_PR_SET_TIMERSLACK = 29  # linux/prctl.h
SLACK = 1000  # [ns] by which the kernel may be late to wake a process that asked for a priority


def apply_priority(priority: int) -> list[str]:
    """Give this process a real-time priority and lock its memory; return what could not be done."""
    problems: list[str] = []

    def attempt(what: str, right: str, action: Callable[[], None]) -> None:
        try:
            action()
        except PermissionError:
            problems.append(f"{what} is not permitted: it needs {right}; going on without")
        except OSError as error:
            problems.append(f"{what}: {error.strerror or error}; going on without")

    if not priority:
        return []
    attempt(
        f"priority = {priority}",
        f"the capability CAP_SYS_NICE, or 'rtprio {priority}' for the user in "
        "/etc/security/limits.d, and in a container a share of real time",
        lambda: _schedule(priority),
    )
    attempt(
        "locked memory",
        "the capability CAP_IPC_LOCK, or 'memlock unlimited' for the user in "
        "/etc/security/limits.d",
        _lock,
    )
    return problems


def _schedule(priority: int) -> None:
    """Schedule all threads of this process; those that are made later are as their maker."""
    for thread in map(int, os.listdir("/proc/self/task")):
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, SLACK)


def _lock() -> None:
    """Keep every page that is there, and will be touched, in memory."""
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        number = ctypes.get_errno()
        if number == errno.ENOMEM:  # more than the limit allows
            number = errno.EPERM
        raise OSError(number, os.strerror(number))
