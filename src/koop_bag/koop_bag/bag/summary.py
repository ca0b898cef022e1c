"""Each second of a loop as least, largest and mean value of what it measured and did."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koop_bag.cdr.definition import parse_definition
from koop_bag.cdr.gather import decode
from koop_bag.cdr.layout import LayoutFinder
from koop_bag.errors import BagError

SECOND = 1_000_000_000  # [ns]
LATE = 10  # [s] for which no message waits to be taken
MODEL = "model_id"
FIELDS: dict[str, tuple[str, ...]] = {
    "koop_msgs/msg/MeasuredState": ("x",),
    "koop_msgs/msg/Cost": ("r", "margin", MODEL),
    "koop_msgs/msg/ControlInput": ("theta",),
}
"""Fields of a message type that are summarised."""


class Statistics(NamedTuple):
    """Least, largest, mean and standard deviation of the finite values of columns.

    Each has shape (n,), of n columns; NaN where no value is finite.
    """

    min: NDArray[np.float64]
    max: NDArray[np.float64]
    mean: NDArray[np.float64]
    std: NDArray[np.float64]


@dataclass
class LoopSecond:
    """A second of a loop."""

    loop: str
    """Namespace of the loop, without a slash at its end."""
    begin: int
    """Begin of the second [ns since the epoch]."""
    count: int = 0
    """States in it."""
    model_id: str = ""
    """Model of its last cost; empty where there is none."""
    statistics: dict[str, Statistics] = field(default_factory=dict)
    """By name: ``x``, ``r``, ``margin``, ``theta``, as far as there were any."""


class Seconds:
    """Gathers messages and makes seconds of them, of any number of loops."""

    def __init__(self) -> None:
        self._sources: dict[int, tuple[str, bool, LayoutFinder]] = {}
        self._open: dict[int, dict[int, list[bytes]]] = {}
        self._channels: dict[str, int] = {}  # measured, by loop
        self._next = 0

    def watch(self, channel: int, topic: str, type_name: str, definition: str) -> None:
        """Summarise a topic, if its type is in FIELDS; its messages come with this channel."""
        if fields := FIELDS.get(type_name):
            finder = LayoutFinder(parse_definition(type_name, definition), fields)
            self._sources[channel] = topic.rpartition("/")[0], "x" in fields, finder

    def add(self, channel: int, time: int, message: bytes) -> None:
        """Take a message that was received at a time [ns since the epoch].

        One that comes when its second is finished counts in the next; one that comes long after
        shows that the clock was set back.
        """
        if channel in self._sources:
            if time // SECOND < self._next - LATE:
                self._next = time // SECOND
            second = self._open.setdefault(max(time // SECOND, self._next), {})
            second.setdefault(channel, []).append(message)

    def finish(self, now: int | None = None) -> Iterator[LoopSecond]:
        """Yield what is over since a second at a time [ns since the epoch]; all without one."""
        end = None if now is None else now // SECOND - 1
        for second in sorted(self._open):
            if end is None or second < end:
                self._next = second + 1
                yield from self._summarise(second, self._open.pop(second))

    def _summarise(self, second: int, messages: dict[int, list[bytes]]) -> Iterator[LoopSecond]:
        loops: dict[str, LoopSecond] = {}
        for channel, items in messages.items():
            loop, is_state, finder = self._sources[channel]
            entry = loops.setdefault(loop, LoopSecond(loop, second * SECOND))
            entry.count += is_state * len(items)
            with suppress(BagError):  # of other lengths within the second: nothing can be said
                columns = _decode(items, finder)
                if MODEL in columns:
                    entry.model_id = columns.pop(MODEL)[-1]
                for name, values in columns.items():
                    entry.statistics[name] = compute_statistics(values)
        for loop, entry in loops.items():
            if "x" in entry.statistics:
                self._channels[loop] = entry.statistics["x"].min.size
            elif loop in self._channels:
                nothing = np.full(self._channels[loop], np.nan)
                entry.statistics["x"] = Statistics(nothing, nothing, nothing, nothing)
            if "x" in entry.statistics:  # a loop begins with its first state
                yield entry


def compute_statistics(values: NDArray[np.float64]) -> Statistics:
    """Return the statistics of values, shape (k,) or (k, n)."""
    columns = values.reshape(len(values), -1)
    finite = np.where(np.isfinite(columns), columns, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a column without a finite value
        return Statistics(
            np.nanmin(finite, axis=0),
            np.nanmax(finite, axis=0),
            np.nanmean(finite, axis=0),
            np.nanstd(finite, axis=0),
        )


def _decode(messages: list[bytes], finder: LayoutFinder) -> dict[str, NDArray[Any]]:
    sizes = np.array([len(message) for message in messages], np.int64)
    buffer = np.frombuffer(b"".join(messages), np.uint8)
    return decode(buffer, np.cumsum(sizes) - sizes, sizes, finder.find)
