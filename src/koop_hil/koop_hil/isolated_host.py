"""Runs a command, with all processes that it starts, on a host of its own."""

from __future__ import annotations

from koop_bringup.live.process import OWN_GROUP, TiedProcess
from koop_hil.hosts import entrance, environment


def call(command: list[str]) -> int:
    """Run a command on a host of its own; return its exit code.

    Raises
    ------
    koop_hil.hosts.HostsError
        If no such host can be made here.
    """
    # Ctrl-C reaches it once, from here
    process = TiedProcess([*entrance(), *command], environment(), **OWN_GROUP)
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise
