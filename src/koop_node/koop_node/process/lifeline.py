"""Ends a process with the one that started it, however that one ended. Pure: no ROS.

The starting process holds the other end of its stdin and says so in its environment. When that
end closes, with a clean exit or with SIGKILL, the process tells itself to stop, as SIGTERM would:
a recorder closes its bag. A pipe, not the kernel's parent-death signal, because that one goes by
the thread that started the process and is lost if the parent is gone before it is asked for.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

VARIABLE = "KOOP_LIFELINE"
TIED = {VARIABLE: "stdin"}  # to be added to the environment of a process whose stdin is a pipe
OWN_GROUP: dict[str, Any] = (
    {"process_group": 0} if sys.version_info >= (3, 11) else {"start_new_session": True}
)
"""Options of Popen, with which Ctrl-C reaches only the parent, which ends the process in order.

Not a session of its own where it can be had: Linux shares the processors out by session, and on a
busy machine threads of such a process waited for up to 4 s (docs/how-to/real-time.md).
"""
DEFERRED = {signal.SIGINT, signal.SIGTERM}
PATIENCE = 20.0  # [s] after which a process that does not stop is killed
PR_SET_PDEATHSIG = 1  # linux/prctl.h


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait, in a process that is started here, until it handles them.

    Before a line of ours runs, Python would print a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, DEFERRED)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def take_signals() -> None:
    """Take the signals that waited: their handlers are in place."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, DEFERRED)


def end_with_parent() -> None:
    """End this process when the one that started it has ended, if that asked for it.

    To be called when the handlers of its signals are in place.
    """
    take_signals()
    if os.environ.get(VARIABLE) != TIED[VARIABLE]:
        return
    # one that was stopped by SIGSTOP would see nothing
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGCONT)
    threading.Thread(target=_watch, daemon=True, name="lifeline").start()


def _watch() -> None:
    with suppress(OSError):  # a terminal that has gone
        while os.read(0, 1024):
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE)
    os.kill(os.getpid(), signal.SIGKILL)
