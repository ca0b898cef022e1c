"""Reads a bag: a rosbag2 MCAP folder or a single file, whole or torn."""

import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from koop_bag.bag.metadata import custom_of, parse_map
from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import McapFile, Place, inner_places

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel id, sequence, log time, publish time; the serialized message follows."""

_CHUNK_TIMES = struct.Struct("<QQ")  # of its first and its last message
_NUMBERED = re.compile(r"_(\d+)\.mcap$")


class RawMessage(NamedTuple):
    """A message as it was recorded; times in nanoseconds since the epoch."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes


@dataclass
class Topic:
    """A recorded topic."""

    name: str
    type_name: str
    definition: str
    encoding: str = "cdr"
    metadata: dict[str, str] = field(default_factory=dict)
    count: int = 0


@dataclass
class FileContents:
    """What one file of a bag holds."""

    file: McapFile
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start: int = 2**63 - 1
    end: int = 0
    notes: dict[str, dict[str, str]] = field(default_factory=dict)


class BagReader:
    """A bag.

    Parameters
    ----------
    path : path
        A bag folder, a folder that holds one as `bag/`, or an `.mcap` file.

    Attributes
    ----------
    topics : tuple of Topic
        In the order of their first announcement.
    message_count : int
        Messages that can be read.
    start_time, end_time : int
        First and last log time [ns since the epoch]; 0 for an empty bag.
    complete : bool
        False if the recorder did not close the bag. It is read up to its last complete chunk.
    notes : dict of str to dict of str to str
        The metadata records of the files.

    Raises
    ------
    BagError
        If the bag is absent, foreign or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files = find_files(self.path)
        self._topics: dict[str, Topic] = {}
        self.message_count = 0
        self.notes: dict[str, dict[str, str]] = {}
        self._contents = [survey(McapFile(file)) for file in self.files]
        self.complete = all(item.file.complete for item in self._contents)
        for item in self._contents:
            self._take_in(item)
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

    def custom_data(self) -> dict[str, str]:
        """The bag's `custom_data`, from the file itself or else from `metadata.yaml`."""
        text = self.notes.get("rosbag2", {}).get("serialized_metadata", "")
        described = parse_map(text, "metadata record")
        description = self.files[0].parent / "metadata.yaml"
        if not described and description.is_file():
            text = description.read_text(encoding="utf-8", errors="replace")
            inner = parse_map(text, "metadata.yaml").get("rosbag2_bagfile_information")
            described = inner if isinstance(inner, dict) else {}
        return custom_of(described)

    def topic(self, name: str) -> Topic:
        """One topic, or an error that names those that are there."""
        if name not in self._topics:
            known = ", ".join(self._topics) or "none"
            raise BagError(f"{self.path} has no topic {name}; it has {known}")
        return self._topics[name]

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[RawMessage]:
        """Messages in the order in which they were recorded.

        Parameters
        ----------
        topics : collection of str, optional
            Only these.
        start, end : int, optional
            Only log times start <= t < end [ns since the epoch].
        """
        for name in topics or ():
            self.topic(name)
        begin, stop = start or 0, 2**64 if end is None else end
        unpack, fixed = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
        for records, names in self.blocks(topics, begin, stop):
            for opcode, at, length in inner_places(records):
                if opcode != Opcode.MESSAGE:
                    continue
                if length < fixed:
                    raise BagError(f"{self.path} is damaged: a message record is cut short")
                channel, sequence, log_time, publish_time = unpack(records, at)
                if channel in names and begin <= log_time < stop:
                    yield RawMessage(
                        names[channel],
                        log_time,
                        publish_time,
                        sequence,
                        records[at + fixed : at + length],
                    )

    def blocks(
        self, topics: Collection[str] | None = None, start: int = 0, end: int = 2**64
    ) -> Iterator[tuple[bytes, dict[int, str]]]:
        """MCAP records chunk by chunk, each with the wanted channels' topics.

        Chunks without a message at start <= log time < end are passed over, unread.
        """
        for item in self._contents:
            wanted = {
                number: channel.topic
                for number, channel in item.channels.items()
                if topics is None or channel.topic in topics
            }
            if not any(item.counts.get(number) for number in wanted):
                continue
            for records in _message_records(item.file, start, end):
                yield records, wanted

    def close(self) -> None:
        """Close the files."""
        for item in self._contents:
            item.file.close()

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take_in(self, item: FileContents) -> None:
        self.notes.update(item.notes)
        for number, channel in item.channels.items():
            schema = item.schemas.get(channel.schema_id)
            type_name, text = (
                (schema.name, schema.data.decode("utf-8", "replace")) if schema else ("", "")
            )
            topic = self._topics.get(channel.topic)
            if topic is None:
                topic = Topic(
                    channel.topic, type_name, text, channel.message_encoding, dict(channel.metadata)
                )
                self._topics[channel.topic] = topic
            elif topic.type_name != type_name:
                types = f"{topic.type_name} and {type_name}"
                raise BagError(
                    f"{self.path}: topic {topic.name} has messages of two types, {types}"
                )
            count = item.counts.get(number, 0)
            topic.count += count
            self.message_count += count


def find_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in the order in which they were recorded."""
    if path.is_file():
        return [path]
    if not path.exists():
        raise BagError(f"there is no bag {path}")
    for folder in (path, path / "bag"):
        files = sorted(folder.glob("*.mcap"), key=_file_number)
        if files:
            return files
        if any(folder.glob("*.db3")):
            raise BagError(
                f"{folder} is an SQLite bag: make it an MCAP one with `ros2 bag convert`"
            )
    raise BagError(f"{path} is no bag: it holds no .mcap file")


def _file_number(path: Path) -> tuple[int, str]:
    match = _NUMBERED.search(path.name)
    return (int(match[1]) if match else 0), path.name


def survey(file: McapFile) -> FileContents:
    """What a file holds: from its summary, or by reading it through where there is none."""
    contents = FileContents(file)
    if file.summary_start and _read_summary(contents):
        return contents
    contents = FileContents(file)
    for place in file.places():
        if place.opcode == Opcode.CHUNK:
            records = file.chunk_records(place)
            for inner in inner_places(records):
                _note(contents, inner, records[inner.start : inner.start + inner.length])
        elif place.opcode == Opcode.DATA_END:
            break
        elif place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA):
            _note(contents, place, file.content(place))
    return contents


def _read_summary(contents: FileContents) -> bool:
    """Whether the summary says everything that reading the file through would."""
    file, counted = contents.file, False
    for place in file.places(file.summary_start):
        if place.opcode == Opcode.STATISTICS:
            statistics = file.parse(Statistics, place)
            contents.counts.update(statistics.channel_message_counts)
            contents.start, contents.end = (
                statistics.message_start_time,
                statistics.message_end_time,
            )
            counted = True
        elif place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _note(contents, place, file.content(place))
        elif place.opcode == Opcode.METADATA_INDEX:
            index = file.parse(MetadataIndex, place)
            offset, length = index.offset, index.length
            _note(
                contents,
                Place(Opcode.METADATA, offset, length),
                file.content(Place(0, offset + 9, length - 9)),
            )
    return counted and all(number in contents.channels for number in contents.counts)


def _note(contents: FileContents, place: Place, data: bytes) -> None:
    file = contents.file
    if place.opcode == Opcode.MESSAGE:
        channel, _, log_time, _ = file.unpack(MESSAGE_HEAD, data, place.start)
        contents.counts[channel] = contents.counts.get(channel, 0) + 1
        contents.start = min(contents.start, log_time)
        contents.end = max(contents.end, log_time)
    elif place.opcode == Opcode.CHANNEL:
        channel_record = file.parse_bytes(Channel, data, place.start)
        contents.channels[channel_record.id] = channel_record
    elif place.opcode == Opcode.SCHEMA:
        schema = file.parse_bytes(Schema, data, place.start)
        contents.schemas[schema.id] = schema
    elif place.opcode == Opcode.METADATA:
        metadata = file.parse_bytes(Metadata, data, place.start)
        contents.notes[metadata.name] = metadata.metadata


def _message_records(file: McapFile, start: int, end: int) -> Iterator[bytes]:
    """Records that hold messages: the inside of each chunk, or messages that lie outside of any."""
    loose = bytearray()
    for place in file.places():
        if place.opcode == Opcode.MESSAGE:
            loose += struct.pack("<BQ", place.opcode, place.length) + file.content(place)
        if loose and (len(loose) > 1 << 20 or place.opcode in (Opcode.CHUNK, Opcode.DATA_END)):
            yield bytes(loose)
            loose.clear()
        if place.opcode == Opcode.CHUNK:
            head = file.content(place._replace(length=min(place.length, _CHUNK_TIMES.size)))
            first, last = file.unpack(_CHUNK_TIMES, head, place.start)
            if first < end and last >= start:
                yield file.chunk_records(place)
        elif place.opcode == Opcode.DATA_END:
            return
    if loose:
        yield bytes(loose)
