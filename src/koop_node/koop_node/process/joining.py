"""Joining a ROS domain, in which Fast DDS 2.14 may hang for ever. Pure: no ROS.

A participant has a mailbox in shared memory, a file that is made first and filled then. Who opens
one waits until it is filled: for ever, if its maker was killed in between, and in rclpy with
Python's lock, so that no thread and no handler of a signal runs.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MAILBOXES = Path("/dev/shm"), "fastrtps_port*[0-9]"
FILLING = 5.0  # [s] in which a mailbox is filled; on a busy machine threads waited for up to 4 s
JOINING = 30.0  # [s] in which a domain is joined; a mailbox whose lock is kept delays by 3 s
_WORD = 4  # bytes at its begin
_UNFILLED = (b"", *(state.to_bytes(_WORD, sys.byteorder) for state in (0, 1)))
"""boost's managed_open_or_create_impl: not yet of its size, UninitializedSegment, Initializing."""


@contextmanager
def joining() -> Iterator[None]:
    """Join a ROS domain within: nothing that was left unfilled is opened.

    One that is left so in this very moment would still be waited for: then the process ends, by a
    signal that the system handles.
    """
    remove_unfilled()
    signal.setitimer(signal.ITIMER_REAL, JOINING)
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


def _unfilled() -> set[Path]:
    """Return the mailboxes that are ours to fill and are not filled."""
    folder, pattern = MAILBOXES
    paths = set()
    for path in folder.glob(pattern):
        with suppress(OSError), open(path, "r+b") as file:  # gone; another user's
            if file.read(_WORD) in _UNFILLED:
                paths.add(path)
    return paths
