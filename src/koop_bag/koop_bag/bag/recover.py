"""Makes a valid bag from a torn or damaged one."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from koop_bag.bag.files import find_files
from koop_bag.bag.message_compression import MessageUnpacker, check_format
from koop_bag.bag.metadata import Description, parse_map, parse_qos, read_description
from koop_bag.bag.writer import BagWriter, WriterOptions
from koop_bag.cdr.schema import MessageSchema
from koop_bag.errors import BagError, BagWriteError
from koop_bag.mcap.file_reader import MESSAGE_HEAD, McapFile, Place, inner_places


@dataclass
class Recovery:
    """Result of a recovery.

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

    Times, sequence numbers, topics, QoS, custom data and notes are kept, so that gaps still show as
    gaps. What was compressed message by message or as a whole file is unpacked.

    Raises
    ------
    BagError
        If there is no bag at `source`, if it is compressed in a way that is not known, or if there
        is a bag at `target` already.
    """
    files = [path for path in find_files(Path(source)) if path.stat().st_size]
    if not files:
        raise BagError(f"{source} holds only empty files: there is nothing to recover")
    with ExitStack() as stack:
        # refuse before anything is written
        opened = [stack.enter_context(closing(McapFile(path))) for path in files]
        description = _description(opened)
        check_format(description, Path(source))
        copy = _Copy(
            stack.enter_context(BagWriter(target, options, description.ros_distro or "jazzy"))
        )
        copy.writer.custom_data.update(description.custom_data)
        for file in opened:
            copy.take(file)
    return copy.report


def _description(files: Sequence[McapFile]) -> Description:
    """Return the bag's description: the last undamaged record of it, or `metadata.yaml`."""
    notes: dict[str, dict[str, str]] = {}
    for file in files:
        for place in file.places():
            if place.opcode == Opcode.METADATA:
                with suppress(BagError):
                    note = file.parse(Metadata, place)
                    parse_map(note.metadata.get("serialized_metadata", ""), "metadata record")
                    notes[note.name] = note.metadata
    try:
        return read_description(notes, files[0].path.parent)
    except BagError:
        return Description()


class _Copy:
    """Copies the files of a bag into a new one."""

    def __init__(self, writer: BagWriter) -> None:
        self.writer = writer
        self.report = Recovery()
        self._topics: dict[str, int] = {}

    def take(self, file: McapFile) -> None:
        """Copy what is readable of one file."""
        content = _FileCopy(file, self.writer, self._topics, self.report)
        end = 0
        for place in file.places():
            end = place.start + place.length
            if place.opcode == Opcode.DATA_END:
                end = file.size
                break
            try:
                records = list(_records(file, place))
            except BagError:
                self.report.damaged_records += 1
                continue
            for opcode, data in records:
                try:
                    content.copy(opcode, data, place.start)
                except BagWriteError:
                    raise
                except (BagError, KeyError):  # KeyError: of a channel whose record was damaged
                    self.report.damaged_records += 1
        self.report.torn_bytes += file.size - end


class _FileCopy:
    """One file of the old bag: it numbers schemas and channels as it likes."""

    def __init__(
        self, file: McapFile, writer: BagWriter, topics: dict[str, int], report: Recovery
    ) -> None:
        self._file, self._writer, self._topics, self._report = file, writer, topics, report
        self._unpacker = MessageUnpacker(file.path)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}  # of the new bag

    def copy(self, opcode: int, data: bytes, where: int) -> None:
        """Copy one record."""
        file = self._file
        if opcode == Opcode.MESSAGE:
            old, sequence, log_time, publish_time = file.unpack(MESSAGE_HEAD, data, where)
            message = self._unpacker.message(data[MESSAGE_HEAD.size :])
            channel = self._channels[old]
            self._writer.write(channel, log_time, publish_time, message, sequence or None)
            self._report.messages += 1
        elif opcode == Opcode.SCHEMA:
            schema = file.parse_bytes(Schema, data, where)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel_record = file.parse_bytes(Channel, data, where)
            name = channel_record.topic
            if name not in self._topics:
                schema = self._schemas[channel_record.schema_id]
                self._topics[name] = _add_topic(self._writer, channel_record, schema)
            self._channels[channel_record.id] = self._topics[name]
        elif opcode == Opcode.METADATA:
            note = file.parse_bytes(Metadata, data, where)
            if note.name == "rosbag2":  # the new bag has its own; this one's content is in there
                parse_map(note.metadata.get("serialized_metadata", ""), "metadata record")
            else:
                self._writer.add_note(note.name, note.metadata)


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
        schema.encoding,
    )
    try:
        qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    except BagError:  # the messages matter more
        qos = []
    return writer.add_topic(channel.topic, definition, qos, channel.message_encoding)
