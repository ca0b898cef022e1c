"""What an operating system can do for a process that must be in time. Pure: no ROS.

Each is done where it is permitted; where it isn't, the process goes on without, and says which
right it lacks.
"""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from collections.abc import Callable, Iterable, Iterator

from koop_core.config.parameter import ConfigError, NodeConfig, processors

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # asm-generic/mman.h
_PR_SET_TIMERSLACK = 29  # linux/prctl.h
SLACK = 1000  # [ns] by which the kernel may be late to wake a process that asked for a priority


def requested(configs: Iterable[NodeConfig]) -> NodeConfig:
    """Return what a process with nodes of these configurations asks for.

    Raises
    ------
    ConfigError
        If they name different processors.
    """
    given = list(configs)
    cpus = sorted({config.cpus for config in given if config.cpus})
    if len(cpus) > 1:
        raise ConfigError(f"nodes of one process share its processors: cpus = {' and '.join(cpus)}")
    return NodeConfig(
        priority=max(config.priority for config in given),
        cpus=cpus[0] if cpus else "",
        lock_memory=any(config.lock_memory for config in given),
    )


def apply(config: NodeConfig) -> list[str]:
    """Do what is asked for, for all threads of this process; return what could not be done."""
    problems: list[str] = []

    def attempt(what: str, right: str, action: Callable[[], None]) -> None:
        try:
            action()
        except PermissionError:
            problems.append(f"{what} is not permitted: it needs {right}; going on without")
        except OSError as error:
            problems.append(f"{what}: {error.strerror or error}; going on without")

    wanted = config.cpus or config.priority or config.lock_memory
    if wanted and sys.platform != "linux":
        return ["priority, cpus and lock_memory are for Linux; going on without"]
    if config.cpus:
        attempt(
            f"cpus = {config.cpus}", "processors of the process's cpuset",
            lambda: _pin(set(processors(config.cpus))),
        )  # fmt: skip
    if config.priority:
        attempt(
            f"priority = {config.priority}",
            f"the capability CAP_SYS_NICE, or 'rtprio {config.priority}' for the user in "
            "/etc/security/limits.d, and in a container a share of real time",
            lambda: _schedule(config.priority),
        )
    if config.lock_memory:
        attempt(
            "lock_memory",
            "the capability CAP_IPC_LOCK, or 'memlock unlimited' for the user in "
            "/etc/security/limits.d",
            _lock,
        )
    return problems


def _threads() -> Iterator[int]:
    """Yield the threads of this process; those that are made later are as their maker."""
    return map(int, os.listdir("/proc/self/task"))


def _pin(cpus: set[int]) -> None:
    for thread in _threads():
        os.sched_setaffinity(thread, cpus)


def _schedule(priority: int) -> None:
    for thread in _threads():
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
