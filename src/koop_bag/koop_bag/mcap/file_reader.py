"""The records of an MCAP file in the order in which they lie there, as far as they are whole.

Reading in file order needs neither the summary nor memory for it, keeps the order in which messages
were received (equal times included), and ends at the last complete record of a torn file.
"""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, McapRecord, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from koop_bag.errors import BagError, compressed
from koop_bag.mcap.stored_file import open_stored

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode, and length of the content that follows."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Begin of a message's content: channel id, sequence, log time, publish time."""

_CHUNK_HEAD = struct.Struct("<QQQII")
"""First and last log time, unpacked size, checksum, length of the compression's name."""

_FOOTER_SIZE = RECORD_HEAD.size + 20 + len(MCAP0_MAGIC)
MAX_CHUNK = 256 << 20
"""The largest chunk that is unpacked [B]: recorders make chunks of some MB, and a file of a few kB
could otherwise fill the memory."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # begin of a file that rosbag2 compressed as a whole
_Parsed = TypeVar("_Parsed", Schema, Channel, Statistics, Metadata, Footer)


class Place(NamedTuple):
    """Where the content of a record lies in its file."""

    opcode: int
    start: int
    length: int


class McapFile:
    """A file of ``size`` bytes opened for reading.

    It is ``complete`` if its recorder closed it; ``summary_start`` is 0 if there is no summary.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = open_stored(path)
        except OSError as error:
            raise BagError(f"cannot open {path}: {error.strerror}") from error
        self.size = self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        self._check_magic()
        self.complete, self.summary_start = self._read_footer()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def places(self, start: int = len(MCAP0_MAGIC)) -> Iterator[Place]:
        """Every complete record from `start` on, up to the footer or the torn end."""
        while start + RECORD_HEAD.size <= self.size:
            self._file.seek(start)
            opcode, length = RECORD_HEAD.unpack(self._file.read(RECORD_HEAD.size))
            content = start + RECORD_HEAD.size
            if opcode == 0 or content + length > self.size:
                return
            yield Place(opcode, content, length)
            if opcode == Opcode.FOOTER:
                return
            start = content + length

    def content(self, place: Place) -> bytes:
        """Return the bytes of a record."""
        if place.length < 0 or place.start + place.length > self.size:
            raise self._damaged(f"it refers to byte {place.start}, where nothing is")
        self._file.seek(place.start)
        return self._file.read(place.length)

    def records(self, place: Place) -> Iterator[tuple[int, bytes]]:
        """Opcode and content of a record, or of each record in a chunk."""
        if place.opcode != Opcode.CHUNK:
            yield place.opcode, self.content(place)
            return
        inside = self.chunk_records(place)
        for opcode, start, length in inner_places(inside):
            yield opcode, inside[start : start + length]

    def parse(self, kind: type[_Parsed], place: Place) -> _Parsed:
        """Return a record as the `mcap` library sees it."""
        return self.parse_bytes(kind, self.content(place), place.start)

    def parse_bytes(self, kind: type[_Parsed], data: bytes, where: int) -> _Parsed:
        """Parse the content of a record; `where` is for the error."""
        try:
            record: McapRecord = kind.read(ReadDataStream(io.BytesIO(data)))
        except (McapError, ValueError, OverflowError, struct.error) as error:
            raise self._damaged(
                f"the {kind.__name__} record at byte {where} does not parse"
            ) from error
        assert isinstance(record, kind)
        return record

    def unpack(self, form: struct.Struct, data: bytes, where: int) -> tuple[int, ...]:
        """Return the begin of a record; `where` is for the error."""
        if len(data) < form.size:
            raise self._damaged(f"the record at byte {where} is cut short")
        return form.unpack_from(data)

    def chunk_records(self, place: Place) -> bytes:
        """Return the records of a chunk, decompressed and checked against the chunk's checksum."""
        content = self.content(place)
        _, _, size, checksum, length = self.unpack(_CHUNK_HEAD, content, place.start)
        end = _CHUNK_HEAD.size + length
        compression = content[_CHUNK_HEAD.size : end].decode(errors="replace")
        packed = content[end + 8 :][: int.from_bytes(content[end : end + 8], "little")]
        if size > MAX_CHUNK:
            raise self._damaged(
                f"the chunk at byte {place.start} claims to unpack to {size} bytes, "
                f"known are up to {MAX_CHUNK}"
            )
        try:
            if compression == "zstd":
                frame = zstandard.get_frame_parameters(packed).content_size
                if frame not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                    raise ValueError("another size than the chunk states")
                data = zstandard.decompress(packed, size)
            elif compression == "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(packed, size + 1)
            elif compression == "":
                data = packed
            else:
                raise BagError(
                    f"{self.path} is compressed with '{compression}'; known are zstd and lz4"
                )
            if len(data) != size:
                raise ValueError("another size than the chunk states")
        except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
            raise self._damaged(f"the chunk at byte {place.start} does not decompress") from error
        if checksum and zlib.crc32(data) != checksum:
            raise self._damaged(f"the chunk at byte {place.start} does not match its checksum")
        return data

    def _damaged(self, what: str) -> BagError:
        return BagError(f"{self.path} is damaged: {what}; `koop bag recover` saves the rest")

    def _check_magic(self) -> None:
        magic = self._file.read(len(MCAP0_MAGIC))
        if magic == MCAP0_MAGIC:
            return
        if self.size == 0:
            raise BagError(
                f"{self.path} is empty: its recorder was stopped before it wrote anything"
            )
        if magic.startswith(ZSTD_MAGIC):
            raise compressed(self.path)
        if magic.startswith(b"SQLite"):
            raise BagError(
                f"{self.path} is an SQLite bag: make it an MCAP one with `ros2 bag convert`"
            )
        raise BagError(f"{self.path} is not an MCAP file")

    def _read_footer(self) -> tuple[bool, int]:
        start = self.size - _FOOTER_SIZE
        if start < len(MCAP0_MAGIC):
            return False, 0
        self._file.seek(start)
        tail = self._file.read(_FOOTER_SIZE)
        if not tail.endswith(MCAP0_MAGIC) or RECORD_HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
            return False, 0
        footer = self.parse_bytes(Footer, tail[RECORD_HEAD.size : -len(MCAP0_MAGIC)], start)
        return True, footer.summary_start if footer.summary_start < start else 0


def inner_places(records: bytes) -> Iterator[Place]:
    """Yield the records inside of a chunk."""
    position, end, unpack = 0, len(records), RECORD_HEAD.unpack_from
    while position + RECORD_HEAD.size <= end:
        opcode, length = unpack(records, position)
        position += RECORD_HEAD.size
        if position + length > end:
            return
        yield Place(opcode, position, length)
        position += length
