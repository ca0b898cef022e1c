"""Starts a node. Pure, and quick to import: an interrupt finds it listening early."""

from __future__ import annotations

import gc
import os
import signal
from pkgutil import resolve_name
from types import FrameType

from koop_node.process.ending import end_process
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
    gc.disable()  # while all is imported; Housekeeping collects from then on
    named = resolve_name(name)
    if not isinstance(named, type):
        end_process(named())
    from koop_node.node.main import run

    end_process(run(named))
