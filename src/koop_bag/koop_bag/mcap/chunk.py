"""Messages gathered into one MCAP chunk.

The records of the file are encoded by the `mcap` library, except those that are written once per
message: there the library spends 3 us on each, and the recorder shares two cores with the loop
that it records.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, McapRecord
from numpy.typing import NDArray

from koop_core.kernels import direct, njit

HEAD = 31
"""Bytes of a message record before the serialized message: opcode, record length, channel id,
sequence, log time, publish time.
"""
MESSAGE = int(Opcode.MESSAGE)
CHANNELS = 1 << 16  # that a file may have
STRADDLE = 1_000_000_000
"""Time [ns] by which a message may be older than the file before it; more: a clock was set back."""

Row = tuple[int, int, int, bytes]
"""log time [ns], channel id, publish time [ns], serialized message."""

LOG_TIME, CHANNEL, PUBLISH_TIME, BEGIN, SIZE = range(5)


class Batch(NamedTuple):
    """Messages in the order in which they were received."""

    table: NDArray[np.int64]
    """Shape (n, 5 or more): a row is a message: log time [ns], channel id, publish time [ns], and
    where it begins in ``data`` and how long it is [B]."""
    data: NDArray[np.uint8]
    """The serialized messages."""

    def rows(self) -> Iterator[Row]:
        """Yield the messages."""
        for log_time, channel, publish_time, begin, size in self.table[:, :5].tolist():
            yield log_time, channel, publish_time, self.data[begin : begin + size].tobytes()


def batch_of(rows: Iterable[Row]) -> Batch:
    """Return rows as a batch."""
    table, parts, begin = [], [], 0
    for log_time, channel, publish_time, data in rows:
        table.append((log_time, channel, publish_time, begin, len(data)))
        parts.append(data)
        begin += len(data)
    whole = np.frombuffer(b"".join(parts), np.uint8)
    return Batch(np.array(table, np.int64).reshape(-1, 5), whole)


class _Progress(NamedTuple):
    """How far a chunk is; each an array, which the kernel writes to."""

    so_far: NDArray[np.int64]
    """Shape (3,): bytes and messages gathered, log time of the first of them [ns]."""
    records: NDArray[np.uint8]
    """Shape (R,): the message records."""
    entries: NDArray[np.int64]
    """Shape (N, 3): channel, log time and place of each."""
    sequences: NDArray[np.uint32]
    """Shape (CHANNELS,): last sequence number of each channel."""


@njit()
def _put(records: NDArray[np.uint8], at: int, value: int, count: int) -> int:
    """Write an integer of so many bytes; return where it ends."""
    for i in range(count):
        records[at + i] = (value >> (8 * i)) & 0xFF
    return at + count


@njit(nogil=True)
def _append(
    batch: Batch, first: int, not_before: int, most: int, age: int, progress: _Progress
) -> tuple[int, bool]:
    """Append messages from one on; return which is next, and whether the chunk is full."""
    so_far, records, entries, sequences = progress
    table, data = batch
    size, count, start = so_far
    full = False
    i = first
    while i < table.shape[0] and not full:
        log_time = table[i, LOG_TIME]
        if 0 < not_before - log_time < STRADDLE:
            log_time = not_before
        channel, begin, length = table[i, CHANNEL], table[i, BEGIN], table[i, SIZE]
        if size == 0:
            start = log_time
        sequences[channel] += 1
        entries[count, 0], entries[count, 1], entries[count, 2] = channel, log_time, size
        at = _put(records, size, MESSAGE, 1)
        at = _put(records, at, HEAD - 9 + length, 8)
        at = _put(records, at, channel, 2)
        at = _put(records, at, np.int64(sequences[channel]), 4)
        at = _put(records, at, log_time, 8)
        at = _put(records, at, table[i, PUBLISH_TIME], 8)
        size = at + length
        for j in range(length):
            records[at + j] = data[begin + j]
        full = size >= most or log_time >= start + age
        count += 1
        i += 1
    so_far[0], so_far[1], so_far[2] = size, count, start
    return i, full


def encode(record: McapRecord) -> bytes:
    """One MCAP record, as the `mcap` library writes it."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


class ChunkBuffer:
    """The chunk in progress, to be compressed by `zstd`, or `none`.

    It is full when its records take ``max_bytes``, or when a message is logged ``max_age`` [ns]
    after the first one.
    """

    def __init__(self, compression: str, max_bytes: int, max_age: int) -> None:
        # One context for all chunks: setting one up costs more than compressing a small chunk.
        self._zstd = zstandard.ZstdCompressor(level=1) if compression == "zstd" else None
        self._compression = compression if self._zstd else ""
        self._max_bytes = max_bytes
        self._max_age = max_age
        self._progress = _Progress(
            np.zeros(3, np.int64),
            np.empty(max_bytes + HEAD, np.uint8),
            np.empty((max_bytes // HEAD + 2, 3), np.int64),
            np.zeros(CHANNELS, np.uint32),
        )
        self.not_before = 0
        """No message is logged just before this time [ns]."""
        none = batch_of(())
        self._append = direct(_append, none, 0, 0, max_bytes, max_age, self._progress)

    @property
    def size(self) -> int:
        """Bytes of the records gathered."""
        return int(self._progress.so_far[0])

    @property
    def start(self) -> int:
        """Log time of the message that opened the chunk [ns]."""
        return int(self._progress.so_far[2])

    def number(self, channel: int, sequence: int) -> None:
        """Let the next message of a channel have a sequence number."""
        self._progress.sequences[channel] = sequence - 1 & 0xFFFFFFFF

    def add(self, batch: Batch, first: int) -> tuple[int, bool]:
        """Take messages from one on; return which is next, and whether the chunk is full."""
        largest = int(batch.table[:, SIZE].max(initial=0))
        if len(self._progress.records) < self._max_bytes + HEAD + largest:
            records = np.empty(self._max_bytes + HEAD + largest, np.uint8)
            records[: self.size] = self._progress.records[: self.size]
            self._progress = self._progress._replace(records=records)
        next_one: tuple[int, bool] = self._append(
            batch, first, self.not_before, self._max_bytes, self._max_age, self._progress
        )
        return next_one

    def is_due(self, now: int) -> bool:
        """Whether messages have waited long enough, or the clock was set back; `now` in ns."""
        return self.size > 0 and not 0 <= now - self.start < self._max_age

    def counts(self) -> dict[int, int]:
        """Messages gathered, by channel."""
        channels, counts = np.unique(self._entries[:, 0], return_counts=True)
        return dict(zip(channels.tolist(), counts.tolist(), strict=True))

    def encode(self, offset: int) -> tuple[bytes, ChunkIndex]:
        """Return the chunk and its message indexes, to lie at `offset`, and its summary entry."""
        records = self._progress.records[: self.size].tobytes()
        stored = records if self._zstd is None else self._zstd.compress(records)
        times = self._entries[:, 1]
        chunk = Chunk(
            compression=self._compression,
            data=stored,
            message_start_time=int(times.min()),
            message_end_time=int(times.max()),
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )
        out = bytearray(encode(chunk))
        chunk_length = len(out)
        index_offsets = {}
        for channel in dict.fromkeys(self._entries[:, 0].tolist()):
            index_offsets[channel] = offset + len(out)
            places = self._entries[self._entries[:, 0] == channel, 1:]
            size = 16 * len(places)
            out += struct.pack("<BQHI", int(Opcode.MESSAGE_INDEX), 6 + size, channel, size)
            out += places.astype("<i8").tobytes()
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
        self._progress.so_far[:] = 0

    @property
    def _entries(self) -> NDArray[np.int64]:
        return self._progress.entries[: int(self._progress.so_far[1])]
