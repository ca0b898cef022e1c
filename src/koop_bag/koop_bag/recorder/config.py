"""Configuration of the recorder."""

from __future__ import annotations

from dataclasses import dataclass

from koop_bag.bag.topics import COMMON_TOPICS
from koop_bag.bag.writer import WriterOptions
from koop_core.config.parameter import ConfigError, NodeConfig, Settings, parameter

LOOP_TOPICS = {
    "state": "koop_msgs/msg/MeasuredState",
    "cost": "koop_msgs/msg/Cost",
    "theta": "koop_msgs/msg/ControlInput",
    "ground_truth": "koop_msgs/msg/PlantTruth",
}
"""Topics of a loop, relative to its namespace."""


@dataclass(frozen=True)
class RecorderConfig(Settings):
    """Configuration of a recording.

    :class:`koop_bag.bag.writer.WriterOptions` bounds what a killed recorder may lose.
    """

    output: str = parameter(
        "", "folder of the run; empty: a new one under recordings/", read_only=True
    )
    topics: str = parameter(
        "",
        "topics to record, separated by spaces, each as name or name:pkg/msg/Type (a type known "
        "in advance is subscribed to at once); empty: the loop's topics, those that all nodes "
        "share, and every other topic that is of the namespace, or that its nodes use",
        read_only=True,
    )
    keep_size: float = parameter(
        0.0,
        "size of all files, above which the oldest are dropped; 0: all are kept. A file is a "
        "twentieth of it. Files around trips of the guard stay in bag/alarms, up to half of it",
        unit="MB",
        low=0.0,
        read_only=True,
    )
    keep_age: float = parameter(
        0.0,
        "age of its last message above which a file is dropped; 0: all are kept. A file covers at "
        "most a twentieth of it; ten files around trips stay without keep_size",
        unit="h",
        low=0.0,
        read_only=True,
    )
    queue: int = parameter(
        10000,
        "messages of one topic that may wait to be written",
        low=10,
        high=1000000,
        read_only=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        wanted_topics(self.topics)

    def writer_options(self) -> WriterOptions:
        """Return how the bag is written."""
        return WriterOptions(
            keep_bytes=int(self.keep_size * 1e6), keep_seconds=self.keep_age * 3600
        )


RECORDER: dict[str, tuple[type, ...]] = {"recorder": (RecorderConfig, NodeConfig)}
"""The node with its configuration classes."""


def wanted_topics(text: str) -> dict[str, str]:
    """Return the chosen topics with their types, empty where the type is not known in advance.

    >>> wanted_topics("state /imu:sensor_msgs/msg/Imu /joint_states")["/imu"]
    'sensor_msgs/msg/Imu'
    """
    chosen: dict[str, str] = {}
    types = LOOP_TOPICS | COMMON_TOPICS
    for item in text.replace(",", " ").split():
        name, _, type_name = item.partition(":")
        if not name or (type_name and type_name.count("/") != 2):
            raise ConfigError(f"topics: '{item}' is neither a name nor name:pkg/msg/Type")
        chosen[name] = type_name or types.get(name, "")
    return chosen
