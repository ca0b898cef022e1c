"""Starts a node. Pure, and quick to import: an interrupt finds it listening early."""

from __future__ import annotations

import os
import signal
import sys
from pkgutil import resolve_name
from types import FrameType

from koop_node.process.lifeline import take_signals


def start(name: str) -> None:
    """Run ``module:Node`` or ``module:function``; SIGINT and SIGTERM end the import cleanly.

    rclpy and numba take a second or more to import, in which Ctrl-C would print a traceback. A node
    handles both signals itself (:func:`koop_node.node.main.run`).
    """

    def on_signal(number: int, frame: FrameType | None) -> None:
        os._exit(0)  # nothing is open yet; an exception would be a traceback of half an import

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    take_signals()
    named = resolve_name(name)
    if not isinstance(named, type):
        sys.exit(named())
    from koop_node.node.main import run

    sys.exit(run(named))
