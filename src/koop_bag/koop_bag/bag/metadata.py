"""The bag's own description: `metadata.yaml`, its copy inside the file, and the offered QoS."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.records import Channel, Schema

from koop_bag.errors import BagError, compressed
from koop_bag.mcap.file_writer import FileRecord

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LONG = 2**31 - 1  # [s] what Foxy wrote for 'no limit'; nobody waits that long

POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown"),
}
"""The policies by the numbers that rosbag2 wrote before version 9 of its metadata (rmw/types.h)."""


SPANS = ("deadline", "lifespan", "liveliness_lease_duration")


@dataclass(frozen=True)
class OfferedQos:
    """QoS of one publisher, in rosbag2's words and order.

    Durations are (seconds, nanoseconds); None is 'no limit'.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: tuple[int, int] | None = None
    lifespan: tuple[int, int] | None = None
    liveliness: str = "automatic"
    liveliness_lease_duration: tuple[int, int] | None = None

    @classmethod
    def from_map(cls, values: Mapping[str, Any]) -> "OfferedQos":
        """Return the inverse of `as_map`; what is absent takes its default."""
        policies: dict[str, Any] = {"depth": int(values.get("depth", 0))}
        for name, words in POLICIES.items():
            if name in values:
                word = values[name]
                policies[name] = words[word] if isinstance(word, int) else str(word)
        for name in SPANS:
            span = values.get(name) or _FOREVER
            policies[name] = None if span["sec"] >= _LONG else (span["sec"], span["nsec"])
        return cls(**policies)

    def as_map(self) -> dict[str, Any]:
        """All keys that rosbag2 demands, in its order."""
        values = asdict(self)
        for name in SPANS:
            span = values[name]
            values[name] = {"sec": span[0], "nsec": span[1]} if span else dict(_FOREVER)
        return {**values, "avoid_ros_namespace_conventions": False}


class TopicRecord(NamedTuple):
    """One recorded topic, with the QoS of its publishers."""

    schema: Schema
    channel: Channel
    qos: tuple[OfferedQos, ...]


def bag_map(
    topics: Sequence[TopicRecord],
    files: Sequence[FileRecord],
    custom: Mapping[str, str],
    ros_distro: str,
) -> dict[str, Any]:
    """Return the inner map of `metadata.yaml` (version 9, ROS 2 Jazzy)."""
    filled = [item for item in files if item.count]
    counts = sum((item.counts for item in filled), Counter[int]())
    start = min((item.start for item in filled), default=2**63 - 1)
    end = max((item.end for item in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max(0, end - start)},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": counts.total(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": schema.name,
                    "serialization_format": channel.message_encoding,
                    "offered_qos_profiles": [item.as_map() for item in qos],
                    "type_description_hash": channel.metadata["topic_type_hash"],
                },
                "message_count": counts[channel.id],
            }
            for schema, channel, qos in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [item.path for item in files],
        "files": [
            {
                "path": item.path,
                "starting_time": {"nanoseconds_since_epoch": item.start},
                "duration": {"nanoseconds": max(0, item.end - item.start)},
                "message_count": item.count,
            }
            for item in files
        ],
        "custom_data": dict(custom),
        "ros_distro": ros_distro,
    }


def read_description(text: str, folder: Path) -> dict[Any, Any]:
    """Return the inner map of a bag's `metadata.yaml`; empty where there is none.

    It is read from the text in the bag's own record, or else from the file in its folder.

    Raises
    ------
    BagError
        If it is not valid YAML.
    """
    described = parse_map(text, "metadata record")
    beside = folder / "metadata.yaml"
    if not described and beside.is_file():
        text = beside.read_text(encoding="utf-8", errors="replace")
        inner = parse_map(text, "metadata.yaml").get("rosbag2_bagfile_information")
        described = inner if isinstance(inner, dict) else {}
    return described


def custom_texts(described: Mapping[Any, Any]) -> dict[str, str]:
    """Return the `custom_data` of a description, without what is not plain text."""
    custom = described.get("custom_data")
    values = custom if isinstance(custom, dict) else {}
    return {str(k): str(v) for k, v in values.items() if isinstance(v, str | int | float)}


def check_messages_plain(described: Mapping[Any, Any], path: Path) -> None:
    """Raise a BagError if rosbag2 compressed a bag message by message."""
    if str(described.get("compression_mode")).upper() == "MESSAGE":
        raise compressed(path)


def parse(text: str, what: str) -> Any:
    """Return the content of a YAML text of a bag, or raise a BagError that names it."""
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise BagError(f"the bag's {what} is not valid YAML") from None


def parse_map(text: str, what: str) -> dict[Any, Any]:
    """`parse` where the text must be a mapping, or empty."""
    content = parse(text, what)
    if content is not None and not isinstance(content, dict):
        raise BagError(f"the bag's {what} is not a mapping")
    return content or {}


def parse_qos(text: str) -> list[OfferedQos]:
    """Return the QoS that the publishers of a topic offered, from the channel's text."""
    try:
        return [OfferedQos.from_map(item) for item in parse(text, "QoS of a topic") or ()]
    except (AttributeError, LookupError, TypeError, ValueError):
        raise BagError("the bag's QoS of a topic is not in rosbag2's form") from None


def dump(value: Any) -> str:
    """YAML in key order, without aliases: rosbag2's parser is not asked to resolve any."""

    class Plain(yaml.CSafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    return str(yaml.dump(value, Dumper=Plain, sort_keys=False, allow_unicode=True, width=1000))
