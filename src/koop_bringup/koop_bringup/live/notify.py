"""Messages to a service manager: the loop is ready, works on, and ends (sd_notify(3))."""

from __future__ import annotations

import os
import socket
from collections.abc import Collection
from contextlib import suppress

from koop_bringup.live.monitor import Progress


class ServiceManager:
    """Tells the service manager that started this process, if one did, how the loop goes.

    A sign of life says that the loop goes on: since the last one each node has reported, and the
    step has moved on or a node says why it does not. Only what a restart mends stops it: a rig that
    is switched off, or a guard that has tripped, does not.
    """

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self._heard: dict[str, float] = {}
        self._step = -1

    @property
    def listens(self) -> bool:
        """Whether there is one."""
        return bool(self._address)

    def report(self, progress: Progress, nodes: Collection[str], status: str) -> None:
        """Give a sign of life, if there is one; ``nodes`` are those that are to report."""
        heard = {node: progress.heard[node] for node in nodes if node in progress.heard}
        if len(heard) < len(nodes) or any(self._heard.get(n) == when for n, when in heard.items()):
            return
        if progress.step == self._step > 0 and not progress.findings.keys() & set(nodes):
            return
        self._heard, self._step = heard, progress.step
        self._say(f"READY=1\nWATCHDOG=1\nSTATUS={status}")

    def end(self) -> None:
        """Say that the loop ends, which takes as long as theta takes to return."""
        self._say("STOPPING=1")

    def _say(self, text: str) -> None:
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
                manager.setblocking(False)
                manager.sendto(text.encode(), self._address)
