"""Messages gathered into one MCAP chunk.

The records of the file are encoded by the `mcap` library, except those that are written once per
message: there the library spends 3 us on each, and the recorder shares two cores with the loop
that it records.
"""

import struct
import zlib
from collections.abc import Callable, Iterator

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, McapRecord

# opcode, record length, channel id, sequence, log time, publish time; the serialized message
# follows
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIXED = 22  # what the record length counts besides the serialized message

Row = tuple[int, int, int, bytes]
"""log time [ns], channel id, publish time [ns], serialized message."""


def encode(record: McapRecord) -> bytes:
    """One MCAP record, as the `mcap` library writes it."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


class ChunkBuffer:
    """The chunk in progress.

    Parameters
    ----------
    compress : callable or None
        Makes the stored bytes of a chunk out of its records; None stores them as they are.
    compression : str
        Its MCAP name, `zstd` or empty.
    max_bytes : int
        The chunk is full when its records take this much [B] ...
    max_age : int
        ... or when a message is logged this long after the first one [ns].
    """

    def __init__(
        self,
        compress: Callable[[bytes], bytes] | None,
        compression: str,
        max_bytes: int,
        max_age: int,
    ) -> None:
        self._compress = compress
        self._compression = compression
        self._max_bytes = max_bytes
        self._max_age = max_age
        self._parts: list[bytes] = []
        self._index: dict[int, list[int]] = {}
        self.size = 0
        """Bytes of the records gathered."""
        self.start = 0
        """Log time of the message that opened the chunk [ns]."""
        self.not_before = 0
        """No message is logged before this time [ns]."""

    def add(self, rows: Iterator[Row], sequences: dict[int, int]) -> bool:
        """Take messages until the chunk is full (True) or no more are there (False).

        `sequences` holds the last sequence number of each channel and is counted up.
        """
        append, pack, opcode = self._parts.append, _MESSAGE_HEAD.pack, int(Opcode.MESSAGE)
        index, size, max_bytes = self._index, self.size, self._max_bytes
        not_before = self.not_before
        full_at = self.start + self._max_age
        full = False
        for log_time, channel, publish_time, data in rows:
            if log_time < not_before:
                log_time = not_before
            if size == 0:
                self.start = log_time
                full_at = log_time + self._max_age
            sequence = sequences[channel] = sequences[channel] + 1 & 0xFFFFFFFF
            length = _MESSAGE_FIXED + len(data)
            append(pack(opcode, length, channel, sequence, log_time, publish_time))
            append(data)
            entries = index.get(channel)
            if entries is None:
                entries = index[channel] = []
            entries.append(log_time)
            entries.append(size)
            size += length + 9
            if size >= max_bytes or log_time >= full_at:
                full = True
                break
        self.size = size
        return full

    def is_due(self, now: int) -> bool:
        """Whether messages have waited long enough; `now` in nanoseconds since the epoch."""
        return self.size > 0 and now - self.start >= self._max_age

    def counts(self) -> dict[int, int]:
        """Messages gathered, by channel."""
        return {channel: len(entries) // 2 for channel, entries in self._index.items()}

    def encode(self, offset: int) -> tuple[bytes, ChunkIndex]:
        """The chunk and its message indexes, to lie at `offset`, and its entry in the summary."""
        records = b"".join(self._parts)
        stored = records if self._compress is None else self._compress(records)
        times = [entries[::2] for entries in self._index.values()]
        chunk = Chunk(
            compression=self._compression,
            data=stored,
            message_start_time=min(map(min, times)),
            message_end_time=max(map(max, times)),
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )
        out = bytearray(encode(chunk))
        chunk_length = len(out)
        index_offsets = {}
        for channel, entries in self._index.items():
            index_offsets[channel] = offset + len(out)
            size = 8 * len(entries)
            out += struct.pack("<BQHI", int(Opcode.MESSAGE_INDEX), 6 + size, channel, size)
            out += struct.pack(f"<{len(entries)}Q", *entries)
        return bytes(out), ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression=self._compression,
            compressed_size=len(stored),
            message_end_time=chunk.message_end_time,
            message_index_length=len(out) - chunk_length,
            message_index_offsets=index_offsets,
            message_start_time=chunk.message_start_time,
            uncompressed_size=len(records),
        )

    def clear(self) -> None:
        """Forget everything gathered."""
        self._parts.clear()
        self._index.clear()
        self.size = 0
