"""Makes a valid bag from a torn or damaged one."""

from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from koop_bag.bag.files import find_files, leave_out_empty
from koop_bag.bag.metadata import (
    check_messages_plain,
    custom_texts,
    parse_map,
    parse_qos,
    read_description,
)
from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import MessageSchema
from koop_bag.errors import BagError, BagWriteError
from koop_bag.mcap.file_reader import MESSAGE_HEAD, McapFile


@dataclass
class Recovery:
    """Result of a recovery."""

    messages: int = 0
    damaged_records: int = 0
    """Chunks and other records left out because their checksum, compression or content was wrong.
    """
    torn_bytes: int = 0
    """Bytes after the last complete record."""


def recover(source: str | Path, target: str | Path) -> Recovery:
    """Copy everything readable of `source` into a new bag `target`; the source is not touched.

    Times, sequence numbers, topics, QoS and custom data are kept, so that gaps still show as gaps.

    Raises
    ------
    BagError
        If there is no bag at `source`, if rosbag2 compressed it, or if there is a bag at `target`
        already.
    """
    files = leave_out_empty(find_files(Path(source)))
    if not files:
        raise BagError(f"{source} holds only empty files: there is nothing to recover")
    with ExitStack() as stack:
        # refuse before anything is written
        opened = [stack.enter_context(closing(McapFile(path))) for path in files]
        described = _description(opened)
        check_messages_plain(described, Path(source))
        distro = str(described.get("ros_distro") or "")
        writer = stack.enter_context(BagWriter(target, ros_distro=distro))
        writer.custom_data.update(custom_texts(described))
        report, topics = Recovery(), dict[str, int]()
        for file in opened:
            _FileCopy(file, writer, topics, report).run()
    return report


def _description(files: Sequence[McapFile]) -> dict[Any, Any]:
    """Return the bag's description: the last undamaged record of it, or `metadata.yaml`."""
    folder = files[0].path.parent
    for file in reversed(files):
        for place in [p for p in file.places() if p.opcode == Opcode.METADATA][::-1]:
            with suppress(BagError):
                note = file.parse(Metadata, place)
                if note.name == "rosbag2":
                    return read_description(note.metadata.get("serialized_metadata", ""), folder)
    with suppress(BagError):
        return read_description("", folder)
    return {}


class _FileCopy:
    """One file of the old bag: it numbers schemas and channels as it likes."""

    def __init__(
        self, file: McapFile, writer: BagWriter, topics: dict[str, int], report: Recovery
    ) -> None:
        self._file, self._writer, self._topics, self._report = file, writer, topics, report
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}  # of the new bag

    def run(self) -> None:
        """Copy what is readable."""
        file, report, end = self._file, self._report, 0
        for place in file.places():
            end = place.start + place.length
            if place.opcode == Opcode.DATA_END:
                end = file.size
                break
            try:
                records = list(file.records(place))
            except BagError:
                report.damaged_records += 1
                continue
            for opcode, data in records:
                try:
                    self._copy(opcode, data, place.start)
                except BagWriteError:
                    raise
                except (BagError, KeyError):  # KeyError: of a channel whose record was damaged
                    report.damaged_records += 1
        report.torn_bytes += file.size - end

    def _copy(self, opcode: int, data: bytes, where: int) -> None:
        file = self._file
        if opcode == Opcode.MESSAGE:
            old, sequence, log_time, publish_time = file.unpack(MESSAGE_HEAD, data, where)
            message, channel = data[MESSAGE_HEAD.size :], self._channels[old]
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
            note = file.parse_bytes(Metadata, data, where)  # its content is in the new bag's own
            parse_map(note.metadata.get("serialized_metadata", ""), "metadata record")


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
