"""Consequences of a node's end for the run. Pure.

The table for all commands is in docs/reference/exit-codes.md.
"""

from __future__ import annotations

import signal
from enum import Enum


class Ending(Enum):
    """Consequence of a node's end."""

    DONE = "the run has done what it was asked to"
    FAILED = "the run ends, and the other nodes with it"
    GO_ON = "the run goes on without the node"


def ending(node: str, exit_code: int, rig: bool) -> Ending:
    """Return what the end of a node means; ``rig`` is the name of the rig's own program.

    A negative exit code is the signal that killed it. A real rig, as ``rig`` says, keeps its
    controller when the recording ends, as on a full disk; a simulation that is not recorded is of
    no use.
    """
    if node in ("vdp_plant", "rig") and exit_code == 0:
        return Ending.DONE
    return Ending.GO_ON if node == "recorder" and rig else Ending.FAILED


def describe_end(node: str, exit_code: int) -> str:
    """Return how a node ended, in words."""
    if exit_code == -signal.SIGALRM:  # koop_node.process.joining
        return f"{node} hung while it joined or left the ROS domain: start again"
    if exit_code < 0:
        return f"{node} was killed by signal {-exit_code}"
    return f"{node} ended with exit code {exit_code}"
