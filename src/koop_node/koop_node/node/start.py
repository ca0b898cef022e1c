"""Starts a node's module. Pure, and quick to import: an interrupt finds it listening early."""

from __future__ import annotations

import importlib
import os
import signal
from types import FrameType

from koop_node.process.lifeline import take_signals


def start(module: str) -> None:
    """Run ``main`` of a module; SIGINT and SIGTERM end the process cleanly while it is imported.

    rclpy and numba take a second or more to import, in which Ctrl-C would print a traceback. From
    ``main`` on the node handles both signals itself (:func:`koop_node.node.main.run`).
    """

    def on_signal(number: int, frame: FrameType | None) -> None:
        os._exit(0)  # nothing is open yet; an exception would be a traceback of half an import

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    take_signals()
    importlib.import_module(module).main()
