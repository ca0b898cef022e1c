"""A program of others beside the nodes.

``python -m koop_node.process.companion PROGRAM ARGUMENT...``.
It ends as a node does: on SIGINT and SIGTERM, which it and all that it started receive, and with
the process that started it (:mod:`koop_node.process.lifeline`). Pure: no ROS.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from contextlib import suppress
from types import FrameType

from koop_node.process.lifeline import PR_SET_PDEATHSIG, VARIABLE, end_with_parent


def main(words: list[str]) -> int:
    """Run the program; return its exit code, 0 if it ended because it was asked to."""
    asked: list[int] = []
    child: subprocess.Popen[bytes] | None = None

    def on_signal(number: int, frame: FrameType | None) -> None:
        asked.append(number)
        if child is not None:
            _signal(child, number)

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    end_with_parent()
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    try:
        child = subprocess.Popen(
            words,
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # a group of its own, which a signal reaches as a whole
            preexec_fn=_end_with_companion,
        )
    except OSError as error:
        print(f"error: {words[0]}: {error.strerror}", file=sys.stderr)
        return 2
    if asked:
        _signal(child, asked[-1])
    code = child.wait()
    _signal(child, signal.SIGKILL)  # what it has left behind
    if asked and (code < 0 or code - 128 in asked):
        return 0
    return 128 - code if code < 0 else code


def _signal(child: subprocess.Popen[bytes], number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, number)


def _end_with_companion() -> None:
    # if the companion is killed, its main thread has ended, too
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
