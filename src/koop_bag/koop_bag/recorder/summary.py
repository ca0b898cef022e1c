"""The long-term record: what is kept for good beside a ring, which drops its old files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from koop_msgs.msg import LoopSummary
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from koop_bag.bag.summary import SECOND, LoopSecond, Seconds
from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import load_schema
from koop_bag.mcap.chunk import Row
from koop_bag.recorder.topics import RecordedTopic
from koop_node.node.received import read_message

NAME = "summary"
"""Folder beside `bag`, and topic of a loop's seconds."""
OPTIONS = WriterOptions(chunk_seconds=10.0, split_bytes=10_000_000)
"""A file is about a day. A kill takes ten seconds, which the ring still has; written one by one,
the seconds of a year would take 10 GB in place of 3.5.
"""


def read_levels(data: bytes) -> dict[str, bytes]:
    """Return the level of each node that a DiagnosticArray reports; of a damaged one, nothing."""
    reports = read_message(data, DiagnosticArray)
    return {} if reports is None else {status.name: status.level for status in reports.status}


KEPT: dict[str, Any] = {
    "koop_msgs/msg/GuardState": lambda data: {"": data},
    "diagnostic_msgs/msg/DiagnosticArray": read_levels,
}
"""Types of which a message is kept where one of these values is another than before."""


class SummaryWriter:
    """A bag of a loop's seconds, its guard's messages and changes of level on /diagnostics."""

    def __init__(self, folder: Path) -> None:
        self._writer = BagWriter(folder / NAME, OPTIONS)
        self._seconds = Seconds()
        self._loops: dict[str, int] = {}
        self._kept: dict[int, tuple[int, Any, dict[str, Any]]] = {}

    def watch(self, channel: int, topic: RecordedTopic) -> None:
        """Keep what matters of a topic; its messages come with this channel."""
        name, schema = topic.name, topic.schema
        self._seconds.watch(channel, name, schema.name, schema.text)
        if schema.name in KEPT:
            here = self._writer.add_topic(name, schema, topic.offered or ())
            self._kept[channel] = here, KEPT[schema.name], {}

    def add(self, rows: Iterable[Row], now: int) -> None:
        """Take messages in the order of reception, and write what is over at `now` [ns]."""
        for received, channel, sent, data in rows:
            self._seconds.add(channel, received, data)
            if channel in self._kept:
                here, values_of, last = self._kept[channel]
                values = values_of(data)
                if last | values != last:
                    last.update(values)
                    self._writer.write(here, received, sent, data)
        self._write(self._seconds.finish(now))
        self._writer.flush_due(now)

    def close(self) -> None:
        """Write what is left, and the end."""
        if not self._writer.closed:
            self._write(self._seconds.finish())
            self._writer.close()

    def _write(self, seconds: Iterable[LoopSecond]) -> None:
        for second in seconds:
            topic = f"{second.loop}/{NAME}"
            if topic not in self._loops:
                schema = load_schema("koop_msgs/msg/LoopSummary")
                self._loops[topic] = self._writer.add_topic(topic, schema)
            end = second.begin + SECOND
            data = serialize_message(make_message(second))
            self._writer.write(self._loops[topic], end, end, data)


def make_message(second: LoopSecond) -> LoopSummary:
    """Return a second as a message."""
    stamp = Time(sec=second.begin // SECOND, nanosec=second.begin % SECOND)
    nan = float("nan")
    message = LoopSummary(header=Header(stamp=stamp), count=second.count, model_id=second.model_id)
    for name in ("r", "margin"):
        for kind in ("min", "max", "mean"):
            setattr(message, f"{name}_{kind}", nan)
    for name, statistics in second.statistics.items():
        for kind, values in statistics._asdict().items():
            if name == "x" or (name == "theta" and kind != "std"):
                setattr(message, f"{name}_{kind}", values.astype("f4").tolist())
            elif kind != "std":
                setattr(message, f"{name}_{kind}", float(values[0].astype("f4")))
    return message
