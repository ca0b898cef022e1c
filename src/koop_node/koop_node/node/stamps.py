"""Times of messages, in seconds and back."""

from __future__ import annotations

import math
import time
from typing import Any

from builtin_interfaces.msg import Time

from koop_core.stream.arrival import Arrival
from koop_core.stream.monitor import StreamMonitor


def to_seconds(stamp: Any) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def to_stamp(nanoseconds: int) -> Time:
    """Return a stamp."""
    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def classify(monitor: StreamMonitor, message: Any, written: float) -> Arrival:
    """Say what a state or cost is that arrives now and was written at a time of its host [s]."""
    return monitor.classify(
        message.step,
        to_seconds(message.header.stamp),
        time.monotonic(),
        math.nan if message.lockstep else written,
    )
