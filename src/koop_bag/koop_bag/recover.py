"""Makes a valid bag of one whose recorder was killed or whose file is damaged."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from koop_bag.errors import BagError
from koop_bag.mcap_scan import McapFile, Place, inner_places
from koop_bag.metadata import OfferedQos
from koop_bag.reader import MESSAGE_HEAD, find_files
from koop_bag.schema import MessageSchema
from koop_bag.writer import BagWriter, WriterOptions


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
    with BagWriter(target, options) as writer:
        for path in files:
            _copy_file(McapFile(path), writer, channels, report)
    return report


def _copy_file(
    file: McapFile, writer: BagWriter, channels: dict[str, int], report: Recovery
) -> None:
    schemas: dict[int, Schema] = {}
    numbers: dict[int, int] = {}  # this file's channel -> the new bag's
    end = 0
    for place in file.places():
        end = place.start + place.length
        if place.opcode == Opcode.DATA_END:
            end = file.size
            break
        try:
            for opcode, data in _records(file, place):
                if opcode == Opcode.MESSAGE:
                    old, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(data)
                    message = data[MESSAGE_HEAD.size :]
                    writer.write(numbers[old], log_time, publish_time, message, sequence or None)
                    report.messages += 1
                elif opcode == Opcode.SCHEMA:
                    schema = file.parse_bytes(Schema, data, place.start)
                    schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = file.parse_bytes(Channel, data, place.start)
                    if channel.topic not in channels:
                        channels[channel.topic] = _add_topic(
                            writer, channel, schemas[channel.schema_id]
                        )
                    numbers[channel.id] = channels[channel.topic]
                elif opcode == Opcode.METADATA:
                    _keep_note(writer, file.parse_bytes(Metadata, data, place.start))
        except (_UnreadableError, KeyError):
            report.damaged_records += 1
    report.torn_bytes += file.size - end
    file.close()


class _UnreadableError(Exception):
    pass


def _records(file: McapFile, place: Place) -> Iterator[tuple[int, bytes]]:
    if place.opcode != Opcode.CHUNK:
        yield place.opcode, file.content(place)
        return
    try:
        records = file.chunk_records(place)
    except BagError as error:
        raise _UnreadableError from error
    for opcode, start, length in inner_places(records):
        yield opcode, records[start : start + length]


def _add_topic(writer: BagWriter, channel: Channel, schema: Schema) -> int:
    definition = MessageSchema(
        schema.name, schema.data.decode(), channel.metadata.get("topic_type_hash", "")
    )
    listed = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
    return writer.add_topic(
        channel.topic, definition, [OfferedQos.from_map(item) for item in listed]
    )


def _keep_note(writer: BagWriter, note: Metadata) -> None:
    if note.name != "rosbag2":
        writer.add_note(note.name, note.metadata)
        return
    described = yaml.safe_load(note.metadata.get("serialized_metadata", "")) or {}
    writer.custom_data.update(described.get("custom_data") or {})
