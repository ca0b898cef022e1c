"""Runs a command in a process that has a host of its own, and so have all that it starts."""

from __future__ import annotations

import subprocess

from koop_hil.hosts import BOUND, entrance, environment


def call(command: list[str]) -> int:
    """Run a command on a host of its own; return its exit code.

    Raises
    ------
    koop_hil.hosts.HostsError
        If no such host can be made here.
    """
    process = subprocess.Popen(
        [*entrance(), *BOUND, *command],
        env=environment(),
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches it once, from here
    )
    try:
        return process.wait()
    except BaseException:
        process.terminate()
        process.wait()
        raise
