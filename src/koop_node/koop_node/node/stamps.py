"""Times of messages, in seconds and back."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time


def to_seconds(stamp: Any) -> float:
    """Return a stamp in seconds; 0 for what is none."""
    return float(stamp.sec + 1e-9 * stamp.nanosec) if hasattr(stamp, "nanosec") else 0.0


def to_stamp(nanoseconds: int) -> Time:
    """Return a stamp."""
    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)
