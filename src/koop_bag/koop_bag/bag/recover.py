"""Makes a valid bag of one whose recorder was killed or whose file is damaged."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from koop_bag.bag.metadata import custom_of, parse_map, parse_qos
from koop_bag.bag.reader import MESSAGE_HEAD, find_files
from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import MessageSchema
from koop_bag.errors import BagError, BagWriteError
from koop_bag.mcap.file_reader import McapFile, Place, inner_places


@dataclass
class Recovery:
    """What was saved.

    Attributes
    ----------
    messages : int
        Messages in the new bag.
    damaged_records : int
        Chunks and other records left out because their checksum, compression or content was wrong.
    torn_bytes : int
        Bytes after the last complete record.
    """

    messages: int = 0
    damaged_records: int = 0
    torn_bytes: int = 0


def recover(
    source: str | Path, target: str | Path, options: WriterOptions | None = None
) -> Recovery:
    """Copy everything readable of `source` into a new bag `target`; the source is not touched.

    Times, sequence numbers, topics, QoS and notes are kept, so that gaps still show as gaps.

    Raises
    ------
    BagError
        If there is no bag at `source`, or one already at `target`.
    """
    files = [path for path in find_files(Path(source)) if path.stat().st_size]
    if not files:
        raise BagError(f"{source} holds only empty files: there is nothing to recover")
    report = Recovery()
    channels: dict[str, int] = {}
    opened = [McapFile(path) for path in files]  # refused before anything is written
    with BagWriter(target, options) as writer:
        for file in opened:
            _copy_file(file, writer, channels, report)
    return report


def _copy_file(
    file: McapFile, writer: BagWriter, channels: dict[str, int], report: Recovery
) -> None:
    schemas: dict[int, Schema] = {}
    numbers: dict[int, int] = {}  # this file's channel -> the new bag's

    def copy(opcode: int, data: bytes, where: int) -> None:
        if opcode == Opcode.MESSAGE:
            old, sequence, log_time, publish_time = file.unpack(MESSAGE_HEAD, data, where)
            message = data[MESSAGE_HEAD.size :]
            writer.write(numbers[old], log_time, publish_time, message, sequence or None)
            report.messages += 1
        elif opcode == Opcode.SCHEMA:
            schema = file.parse_bytes(Schema, data, where)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = file.parse_bytes(Channel, data, where)
            if channel.topic not in channels:
                channels[channel.topic] = _add_topic(writer, channel, schemas[channel.schema_id])
            numbers[channel.id] = channels[channel.topic]
        elif opcode == Opcode.METADATA:
            _keep_note(writer, file.parse_bytes(Metadata, data, where))

    end = 0
    for place in file.places():
        end = place.start + place.length
        if place.opcode == Opcode.DATA_END:
            end = file.size
            break
        try:
            records = list(_records(file, place))
        except BagError:
            report.damaged_records += 1
            continue
        for opcode, data in records:
            try:
                copy(opcode, data, place.start)
            except BagWriteError:
                raise
            except (BagError, KeyError):  # KeyError: of a channel whose record was damaged
                report.damaged_records += 1
    report.torn_bytes += file.size - end
    file.close()


def _records(file: McapFile, place: Place) -> Iterator[tuple[int, bytes]]:
    if place.opcode != Opcode.CHUNK:
        yield place.opcode, file.content(place)
        return
    records = file.chunk_records(place)
    for opcode, start, length in inner_places(records):
        yield opcode, records[start : start + length]


def _add_topic(writer: BagWriter, channel: Channel, schema: Schema) -> int:
    definition = MessageSchema(
        schema.name,
        schema.data.decode("utf-8", "replace"),
        channel.metadata.get("topic_type_hash", ""),
    )
    try:
        qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    except BagError:  # the messages matter more
        qos = []
    return writer.add_topic(channel.topic, definition, qos)


def _keep_note(writer: BagWriter, note: Metadata) -> None:
    if note.name != "rosbag2":
        writer.add_note(note.name, note.metadata)
        return
    described = parse_map(note.metadata.get("serialized_metadata", ""), "metadata record")
    writer.custom_data.update(custom_of(described))
