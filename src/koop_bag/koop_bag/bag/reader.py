"""Reads a bag: a rosbag2 MCAP folder or a single file, whole or torn."""

from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Schema

from koop_bag.bag.contents import FileContents, message_records, survey
from koop_bag.bag.files import find_files, leave_out_empty
from koop_bag.bag.metadata import (
    check_messages_plain,
    custom_texts,
    parse_map,
    read_description,
)
from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import MESSAGE_HEAD, McapFile, inner_places
from koop_bag.mcap.stored_file import stored_path

_NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")  # of a channel without one


class RawMessage(NamedTuple):
    """A message as it was recorded; times in nanoseconds since the epoch."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


@dataclass
class BagTopic:
    """A topic of a bag."""

    name: str
    type_name: str
    definition: str
    language: str = "ros2msg"
    """Of the definition; others than that of .msg files are not read."""
    encoding: str = "cdr"
    metadata: dict[str, str] = field(default_factory=dict)
    count: int = 0


class BagReader(AbstractContextManager["BagReader"]):
    """A bag: its folder, a folder that holds one as `bag/`, an `.mcap` file, or the URL of one.

    A URL is such as s3://BUCKET/RUN. The ``topics`` are in the order of their first announcement,
    ``message_count`` messages can be read. A bag that its recorder did not close, which is not
    ``complete``, is read up to its last complete chunk. ``start_time`` and ``end_time`` are first
    and last log time [ns since the epoch]; 0 for an empty bag.

    Raises
    ------
    BagError
        If the bag is absent, foreign or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = stored_path(path)
        self.files = find_files(self.path)
        self._topics: dict[str, BagTopic] = {}
        self.message_count = 0
        self._contents: list[FileContents] = []
        with ExitStack() as opened:
            for file in leave_out_empty(self.files) or self.files:
                self._contents.append(survey(opened.enter_context(closing(McapFile(file)))))
                self._take_in(self._contents[-1])
            described: dict[Any, Any] = {}
            with suppress(BagError):  # what asks for it raises it again
                described = self.description
            check_messages_plain(described, self.path)
            self._files = opened.pop_all()
        self.complete = len(self._contents) == len(self.files) and all(
            item.file.complete for item in self._contents
        )
        filled = [item for item in self._contents if any(item.counts.values())]
        self.topics = tuple(self._topics.values())
        self.start_time = min((item.start for item in filled), default=0)
        self.end_time = max((item.end for item in filled), default=0)

    @property
    def duration(self) -> float:
        """From the first to the last message [s]."""
        return (self.end_time - self.start_time) * 1e-9

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(item.file.size for item in self._contents)

    @cached_property
    def description(self) -> dict[Any, Any]:
        """The inner map of the bag's `metadata.yaml`; empty where there is none."""
        texts = [item.description for item in self._contents if item.description]
        return read_description(texts[-1] if texts else "", self.files[0].parent)

    def custom_data(self) -> dict[str, str]:
        """Return the bag's `custom_data`."""
        return custom_texts(self.description)

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters by node, as they were recorded; what is not of a node is left out.

        They stand in the bag itself, or in the run's folder while the bag is not closed.
        """
        text, folder = self.custom_data().get("parameters", ""), self.files[0].parent
        for place in (folder, folder.parent):
            if not text and (file := place / "parameters.yaml").is_file():
                text = file.read_text(encoding="utf-8", errors="replace")
        nodes = parse_map(text, "record of parameters")
        sections = {
            str(name): node.get("ros__parameters")
            for name, node in nodes.items()
            if isinstance(node, dict)
        }
        return {name: values for name, values in sections.items() if isinstance(values, dict)}

    def inactive_steps(self, topic: str) -> int:
        """Return the steps of a topic that passed while its publisher or the recorder was inactive.

        They are gaps in the steps, and not lost.
        """
        try:
            steps = parse_map(self.custom_data().get("inactive", ""), "record of inactive nodes")
        except BagError:
            return 0
        count = steps.get(topic)
        return max(0, count) if isinstance(count, int) else 0

    def topic(self, name: str) -> BagTopic:
        """Return a topic, or raise an error that names the topics of the bag."""
        if name not in self._topics:
            topics = ", ".join(self._topics) or "none"
            raise BagError(f"{self.path} has no topic {name}; it has {topics}")
        return self._topics[name]

    def messages(
        self, topics: Collection[str] | None = None, start: int = 0
    ) -> Iterator[RawMessage]:
        """Messages, in the order of recording, with log times from ``start`` [ns] on."""
        for name in topics or ():
            self.topic(name)
        unpack, fixed = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
        for records, names in self.blocks(topics, start):
            for opcode, at, length in inner_places(records):
                if opcode != Opcode.MESSAGE:
                    continue
                if length < fixed:
                    raise BagError(f"{self.path} is damaged: a message record is cut short")
                channel, sequence, log_time, publish_time = unpack(records, at)
                if channel in names and log_time >= start:
                    yield RawMessage(
                        names[channel],
                        log_time,
                        publish_time,
                        sequence,
                        records[at + fixed : at + length],
                    )

    def blocks(
        self, topics: Collection[str] | None = None, start: int = 0
    ) -> Iterator[tuple[bytes, dict[int, str]]]:
        """MCAP records chunk by chunk, each with the wanted channels' topics.

        Chunks without a message of these, or from `start` on, are passed over, unread.
        """
        for item in self._contents:
            wanted = {
                number: channel.topic
                for number, channel in item.channels.items()
                if topics is None or channel.topic in topics
            }
            if not any(item.counts.get(number) for number in wanted):
                continue
            for records in message_records(item.file, start, wanted):
                yield records, wanted

    def close(self) -> None:
        """Close the files."""
        self._files.close()

    def __exit__(self, *error: object) -> None:
        self.close()

    def _take_in(self, item: FileContents) -> None:
        for number, channel in item.channels.items():
            schema = item.schemas.get(channel.schema_id, _NO_SCHEMA)
            topic = self._topics.get(channel.topic)
            if topic is None:
                topic = self._topics[channel.topic] = BagTopic(
                    channel.topic,
                    schema.name,
                    schema.data.decode("utf-8", "replace"),
                    schema.encoding,
                    channel.message_encoding,
                    dict(channel.metadata),
                )
            elif topic.type_name != schema.name:
                types = f"{topic.type_name} and {schema.name}"
                raise BagError(
                    f"{self.path}: topic {topic.name} has messages of two types, {types}"
                )
            count = item.counts.get(number, 0)
            topic.count += count
            self.message_count += count
