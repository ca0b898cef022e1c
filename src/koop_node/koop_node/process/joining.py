"""Joining and leaving a ROS domain, where Fast DDS may hang for ever. Pure: no ROS.

A participant has a mailbox in shared memory, a file that is made first and filled then. Who opens
one waits until it is filled: for ever, if its maker was killed in between, and in rclpy with
Python's lock, so that no thread and no handler of a signal runs. What a participant sends is in a
file of half a megabyte; one that is killed leaves it behind, with a lock that is free then.

Who leaves waits with a lock held until none of its participant's callbacks runs
(``DomainParticipantImpl::set_listener``, Fast DDS issue 6513); one that has just begun waits for
that lock. So it happens where processes end together, again with Python's lock.
"""

from __future__ import annotations

import fcntl
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FAST_DDS = "fastrtps" if os.environ.get("ROS_DISTRO", "jazzy") == "jazzy" else "fastdds"
"""How what is Fast DDS's is called: 2.14 in Jazzy, 3 in what came after."""
FOLDER = Path("/dev/shm")
MAILBOXES, LOCKS = f"{FAST_DDS}_port*[0-9]", f"{FAST_DDS}_" + 16 * "[0-9a-f]" + "_el"
LOCKED = 60.0  # [s] after which a new lock is taken by its maker
FILLING = 5.0  # [s] in which a mailbox is filled; on a busy machine threads waited for up to 4 s
JOINING = 30.0  # [s] in which a domain is joined; a mailbox whose lock is kept delays by 3 s
LEAVING = 8.0  # [s] in which it is left, which takes 0.1 s on an idle machine
_WORD = 4  # bytes at its begin
_UNFILLED = (b"", *(state.to_bytes(_WORD, sys.byteorder) for state in (0, 1)))
"""boost's managed_open_or_create_impl: not yet of its size, UninitializedSegment, Initializing."""


@contextmanager
def joining() -> Iterator[None]:
    """Join a ROS domain within: nothing that was left unfilled is opened.

    One that is left so in this very moment would still be waited for: then the process ends.
    """
    remove_unfilled()
    remove_dead()
    with _ended_after(JOINING):
        yield


@contextmanager
def leaving() -> Iterator[None]:
    """Leave a ROS domain within, or the process ends: what it had to do must be done."""
    with _ended_after(LEAVING):
        yield


@contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """End this process by SIGALRM, which the system handles, if what is within takes longer."""
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def remove_unfilled() -> None:
    """Remove the mailboxes that nobody fills; a killed process may have left one."""
    deadline = time.monotonic() + FILLING
    left = _unfilled()
    while left and time.monotonic() < deadline:
        time.sleep(0.05)
        left &= _unfilled()
    for path in left:
        with suppress(FileNotFoundError):  # another process was quicker
            path.unlink()


def remove_dead() -> None:
    """Remove what killed processes had sent."""
    for path in FOLDER.glob(LOCKS):
        with suppress(OSError), open(path) as lock:  # it lives; another process was quicker
            if time.time() - os.fstat(lock.fileno()).st_mtime > LOCKED:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.with_name(path.name.removesuffix("_el")).unlink(missing_ok=True)
                path.unlink()


def _unfilled() -> set[Path]:
    """Return the mailboxes that are ours to fill and are not filled."""
    paths = set()
    for path in FOLDER.glob(MAILBOXES):
        with suppress(OSError), open(path, "r+b") as file:  # gone; another user's
            if file.read(_WORD) in _UNFILLED:
                paths.add(path)
    return paths
