"""One MCAP file being written: chunks through to the disk, then the summary."""

import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from koop_bag.errors import BagWriteError, writing
from koop_bag.mcap.chunk import ChunkBuffer, encode
from koop_core.whole_file import FULL

_BLOCK = 1 << 16  # [B] of records that are packed together


@dataclass
class FileRecord:
    """What a file holds; times in ns since the epoch, `start` > `end` while it is empty."""

    path: str
    """Its name."""
    start: int = 2**63 - 1
    end: int = 0
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    size: int = 0
    """Bytes."""
    of_alarm: bool = False
    """Whether it is kept for good."""

    @property
    def count(self) -> int:
        """Messages in it."""
        return self.counts.total()


class McapFileWriter:
    """Appends whole records to a file; what it has accepted survives the end of the process.

    Each chunk goes out in one unbuffered write, so a killed process loses only the chunk in
    progress. A write that fails halfway is taken back: the file always ends with a complete record.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.record = FileRecord(path.name)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks = _Packed()
        self._metadata: list[bytes] = []
        with writing(f"create {path}"):
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 - open as long as the bag
        self._append(MCAP0_MAGIC + encode(Header(profile="ros2", library=_library())))

    def add_channel(self, schema: Schema, channel: Channel) -> None:
        """Announce a topic.

        Outside of any chunk, so that even an empty or torn file names its topics.
        """
        new_schema = all(other.id != schema.id for other in self._schemas)
        self._append((encode(schema) if new_schema else b"") + encode(channel))
        if new_schema:
            self._schemas.append(schema)
        self._channels.append(channel)

    def add_chunk(self, chunk: ChunkBuffer) -> None:
        """Write a chunk with its message indexes."""
        record = self.record
        data, index = chunk.encode(record.size)
        self._append(data)
        self._chunks.append(encode(index))
        record.counts.update(chunk.counts())
        record.start = min(record.start, index.message_start_time)
        record.end = max(record.end, index.message_end_time)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data = encode(Metadata(name=name, metadata=dict(values)))
        offset = self.record.size
        self._append(data)
        self._metadata.append(encode(MetadataIndex(offset=offset, length=len(data), name=name)))

    def finish(self) -> None:
        """Write the summary and close. Not every reader takes a file without one."""
        try:
            self._append(self._closing_records())
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close without a summary."""
        self._file.close()

    def _closing_records(self) -> bytes:
        out = bytearray(encode(DataEnd(data_section_crc=0)))
        summary_start = self.record.size + len(out)
        summary = bytearray()
        offsets: list[McapRecord] = []

        def group(opcode: Opcode, records: list[bytes]) -> None:
            data = b"".join(records)
            if data:
                start = summary_start + len(summary)
                offsets.append(
                    SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(data))
                )
                summary.extend(data)

        group(Opcode.SCHEMA, [encode(item) for item in self._schemas])
        group(Opcode.CHANNEL, [encode(item) for item in self._channels])
        group(Opcode.STATISTICS, [encode(self._statistics())])
        group(Opcode.CHUNK_INDEX, self._chunks.blocks())
        group(Opcode.METADATA_INDEX, self._metadata)
        offset_start = summary_start + len(summary)
        summary += b"".join(encode(item) for item in offsets)
        # The checksum covers the footer up to itself.
        head = struct.pack("<BQQQ", int(Opcode.FOOTER), 20, summary_start, offset_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        out += summary
        out += encode(
            Footer(summary_start=summary_start, summary_offset_start=offset_start, summary_crc=crc)
        )
        return bytes(out + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        record = self.record
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(record.counts.items())),
            chunk_count=self._chunks.count,
            message_count=record.count,
            message_end_time=record.end,
            message_start_time=record.start if record.count else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _append(self, data: bytes) -> None:
        view = memoryview(data)
        done = 0
        try:
            while done < len(view):  # a raw write may take only a part
                done += self._file.write(view[done:])
        except OSError as error:
            with suppress(OSError):  # if the device is gone, so is the chance to tidy up
                self._file.truncate(self.record.size)
                self._file.seek(self.record.size)
            where = f"{self.path} ({self.record.size} bytes are safe)"
            if error.errno in FULL:
                raise BagWriteError(
                    f"no space left for {where}: free some on the disk of {self.path.parent} "
                    f"({error.strerror}) or record to another one"
                ) from error
            raise BagWriteError(f"cannot write {where}: {error.strerror}") from error
        self.record.size += done


def _library() -> str:
    """Return the name of the library that writes a file."""
    try:
        return f"koop_bag {version('koop_bag')}"
    except PackageNotFoundError:
        return "koop_bag"


class _Packed:
    """Records that wait for the summary, compressed: ten chunks a second are not to be seen."""

    def __init__(self) -> None:
        self.count = 0
        self._packed: list[bytes] = []
        self._loose = bytearray()

    def append(self, record: bytes) -> None:
        self.count += 1
        self._loose += record
        if len(self._loose) >= _BLOCK:
            self._packed.append(zlib.compress(self._loose))
            self._loose.clear()

    def blocks(self) -> list[bytes]:
        """All records in their order."""
        return [*map(zlib.decompress, self._packed), bytes(self._loose)]
