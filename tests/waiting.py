"""Waiting for what other processes do."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any

# [s] for anything to happen on a busy machine; nothing waits this long if all is well
TIMEOUT = 120.0


def wait(
    condition: Callable[[], Any],
    what: str,
    process: subprocess.Popen[str] | None = None,
    seconds: float = TIMEOUT,
) -> Any:
    """Return what the condition is once it is true; fail if it does not become so, in words.

    So it does if a process that is to see to it ends: what that said is shown.
    """
    deadline = time.monotonic() + seconds
    while not (actual := condition()):
        assert time.monotonic() < deadline, f"timed out after {seconds:g} s: {what}"
        assert process is None or process.poll() is None, (what, process.communicate())
        time.sleep(0.02)
    return actual
