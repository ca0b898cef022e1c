"""Contents of one file of a bag."""

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema, Statistics

from koop_bag.mcap.file_reader import MESSAGE_HEAD, RECORD_HEAD, McapFile, Place

_NOTED = (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA)
_CHANNEL = struct.Struct("<H")  # of an index
_CHUNK_TIMES = struct.Struct("<QQ")  # of its first and its last message


@dataclass
class FileContents:
    """Contents of one file of a bag."""

    file: McapFile
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start: int = 2**63 - 1
    end: int = 0
    description: str = ""
    """The bag's, as its recorder last wrote it here."""


def survey(file: McapFile) -> FileContents:
    """Return a file's contents: from its summary, or by reading it through where there is none."""
    contents = FileContents(file)
    if file.summary_start and _read_summary(contents):
        return contents
    contents = FileContents(file)
    for place in file.places():
        if place.opcode == Opcode.DATA_END:
            break
        if place.opcode in _NOTED:
            for opcode, data in file.records(place):
                _note(contents, opcode, data, place.start)
    return contents


def _read_summary(contents: FileContents) -> bool:
    """Return whether the summary holds everything that reading the file through would give."""
    file, counted = contents.file, False
    for place in file.places(file.summary_start):
        if place.opcode == Opcode.STATISTICS:
            statistics = file.parse(Statistics, place)
            contents.counts.update(statistics.channel_message_counts)
            contents.start = statistics.message_start_time
            contents.end = statistics.message_end_time
            # a writer may leave out how many each channel has, and say how many there are
            counted = sum(contents.counts.values()) == statistics.message_count
        elif place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _note(contents, place.opcode, file.content(place), place.start)
        elif place.opcode == Opcode.METADATA_INDEX:
            index = file.parse(MetadataIndex, place)
            head = RECORD_HEAD.size
            data = file.content(Place(0, index.offset + head, index.length - head))
            _note(contents, Opcode.METADATA, data, index.offset)
    schemas = {channel.schema_id for channel in contents.channels.values()} - {0}  # 0: has none
    has_channels = contents.counts.keys() <= contents.channels.keys()
    return counted and has_channels and schemas <= contents.schemas.keys()


def _note(contents: FileContents, opcode: int, data: bytes, where: int) -> None:
    file = contents.file
    if opcode == Opcode.MESSAGE:
        channel, _, log_time, _ = file.unpack(MESSAGE_HEAD, data, where)
        contents.counts[channel] = contents.counts.get(channel, 0) + 1
        contents.start = min(contents.start, log_time)
        contents.end = max(contents.end, log_time)
    elif opcode == Opcode.CHANNEL:
        channel_record = file.parse_bytes(Channel, data, where)
        contents.channels[channel_record.id] = channel_record
    elif opcode == Opcode.SCHEMA:
        schema = file.parse_bytes(Schema, data, where)
        contents.schemas[schema.id] = schema
    elif opcode == Opcode.METADATA:
        metadata = file.parse_bytes(Metadata, data, where)
        if metadata.name == "rosbag2":
            contents.description = metadata.metadata.get("serialized_metadata", "")


def message_records(file: McapFile, start: int, channels: Collection[int]) -> Iterator[bytes]:
    """Yield records that hold messages: the inside of each chunk, or a message outside of any.

    A chunk that ends before ``start`` [ns], or whose indexes name none of the channels, is passed
    over, unread. Indexes count only where another record follows them: a torn file may lack some.
    """
    chunk, indexed = None, set[int]()
    for place in file.places():
        if place.opcode == Opcode.MESSAGE_INDEX:
            indexed |= {*_read_head(file, place, _CHANNEL)}
            continue
        if chunk is not None and (not indexed or not indexed.isdisjoint(channels)):
            yield file.chunk_records(chunk)
        chunk, indexed = None, set()
        if place.opcode == Opcode.MESSAGE:
            yield RECORD_HEAD.pack(place.opcode, place.length) + file.content(place)
        elif place.opcode == Opcode.CHUNK:
            _, last = _read_head(file, place, _CHUNK_TIMES)
            chunk = place if last >= start else None
        elif place.opcode == Opcode.DATA_END:
            return
    if chunk is not None:
        yield file.chunk_records(chunk)


def _read_head(file: McapFile, place: Place, form: struct.Struct) -> tuple[int, ...]:
    """Read no more of a record than its begin."""
    head = file.content(place._replace(length=min(place.length, form.size)))
    return file.unpack(form, head, place.start)
