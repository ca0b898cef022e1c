"""Fields of a topic as numpy arrays, without decoding one message after the other."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from koop_bag.bag.reader import BagReader
from koop_bag.cdr.definition import leaf_fields, parse_definition
from koop_bag.cdr.gather import Bytes, Offsets, at_every_byte, check_lengths, decode
from koop_bag.cdr.layout import Layout, LayoutFinder
from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import MESSAGE_HEAD, RECORD_HEAD
from koop_core.cdr import Struct

Columns = dict[str, NDArray[Any]]

LOG_TIME, PUBLISH_TIME, SEQUENCE = "log_time", "publish_time", "sequence"
"""Columns that every topic has: when received and sent [ns since the epoch], and the number in the
recording. A field of a message that has such a name is written with a dot before it."""

BATCH_BYTES = 8 << 20
"""Bytes of a bag that are held at once: enough that the cost per batch vanishes."""

_RECORD = struct.Struct("<BQH")  # opcode, length, and the channel if it is a message
STORED: dict[str, tuple[int, str]] = {
    SEQUENCE: (2, "<u4"),
    LOG_TIME: (6, "<u8"),
    PUBLISH_TIME: (14, "<u8"),
}
"""Where the columns that every topic has lie in a message record, and their type."""


def list_fields(bag: BagReader, topic: str) -> list[str]:
    """Return the fields of a topic that can be read as columns."""
    leaves = leaf_fields(definition_of(bag, topic))
    return [f".{name}" if name in STORED else name for name in leaves]


def read_columns(
    bag: BagReader | str | Path, topic: str, fields: Sequence[str] | None = None
) -> Columns:
    """One topic as arrays.

    Parameters
    ----------
    bag : BagReader or path
        The bag, or what :class:`~koop_bag.bag.reader.BagReader` takes.
    topic : str
        Its full name.
    fields : sequence of str, optional
        Numeric fields (`step`), nested ones (`header.stamp.sec`), times (`header.stamp`, as int64
        nanoseconds), arrays (`x`, shape (n, length); the length must be the same in all messages),
        elements (`position[0]`), strings (as an object array), and `log_time`, `publish_time`,
        `sequence`. Default: all that can be read.

    Returns
    -------
    dict of str to ndarray
        By field, each with n rows in the order of recording. An element beyond the end of its array
        is NaN.

    Raises
    ------
    BagError
        If there is no such topic or field, or if a message does not fit its definition.
    """
    if isinstance(bag, str | Path):
        with BagReader(bag) as opened:
            return read_columns(opened, topic, fields)
    return read_tables(bag, {topic: fields})[topic]


def read_tables(bag: BagReader, tables: Mapping[str, Sequence[str] | None]) -> dict[str, Columns]:
    """Several topics in one pass over the bag: `{topic: fields}` to `{topic: columns}`."""
    parts: dict[str, list[Columns]] = {topic: [] for topic in tables}
    for topic, columns in iter_tables(bag, tables):
        parts[topic].append(columns)
    joined: dict[str, Columns] = {}
    for topic, fields in tables.items():
        names = list_fields(bag, topic) if fields is None else fields
        batches = parts.pop(topic) or [{name: np.empty(0) for name in names}]
        joined[topic] = {}
        for name in names:
            arrays = [batch.pop(name) for batch in batches]
            check_lengths(name, arrays)
            joined[topic][name] = np.concatenate(arrays)
    return joined


def iter_tables(
    bag: BagReader, tables: Mapping[str, Sequence[str] | None], start: int = 0
) -> Iterator[tuple[str, Columns]]:
    """`read_tables` in batches of (topic, columns): the memory needed does not grow with the bag.

    Chunks that end before `start` [ns since the epoch] are passed over.
    """
    wanted = {topic: _want(bag, topic, fields) for topic, fields in tables.items()}
    pending: list[bytes] = []
    names: dict[int, str] = {}
    size = 0
    for records, channels in bag.blocks(wanted, start):
        # another file may number its channels otherwise
        if pending and (size >= BATCH_BYTES or channels != names):
            yield from _decode_batch(b"".join(pending), names, wanted)
            pending, size = [], 0
        names = channels
        pending.append(records)
        size += len(records)
    if pending:
        yield from _decode_batch(b"".join(pending), names, wanted)


class _Wanted(NamedTuple):
    """The wanted columns of a topic, and what finds the layout of a message with its fields."""

    columns: Sequence[str]
    find: Callable[[bytes], Layout] | None
    """None where no field is wanted, but what every topic has."""


def _want(bag: BagReader, topic: str, fields: Sequence[str] | None) -> _Wanted:
    columns = list_fields(bag, topic) if fields is None else fields
    taken = tuple(name for name in columns if name not in STORED)
    return _Wanted(columns, LayoutFinder(definition_of(bag, topic), taken).find if taken else None)


def _decode_batch(
    records: bytes, names: dict[int, str], tables: Mapping[str, _Wanted]
) -> Iterator[tuple[str, Columns]]:
    places: dict[int, list[int]] = {number: [] for number in names}
    # The one loop over messages: opcode, length and channel in one step, no call but the unpacking.
    unpack, head, message = _RECORD.unpack_from, RECORD_HEAD.size, int(Opcode.MESSAGE)
    position, last = 0, len(records) - _RECORD.size
    while position <= last:
        opcode, length, channel = unpack(records, position)
        position += head
        if position + length > len(records):
            break
        if opcode == message and channel in places:
            places[channel] += (position, length)
        position += length
    buffer = np.frombuffer(records, np.uint8)
    for number, pairs in places.items():
        if pairs:
            where = np.array(pairs, np.int64)
            topic = names[number]
            yield topic, _decode_topic(topic, tables[topic], buffer, where[::2], where[1::2])


def _decode_topic(
    topic: str, wanted: _Wanted, buffer: Bytes, starts: Offsets, sizes: Offsets
) -> Columns:
    """Columns of the message records whose content starts at `starts`."""
    fixed = MESSAGE_HEAD.size
    if (sizes < fixed).any():
        raise BagError(f"topic {topic}: a message record is cut short")
    columns: Columns = {}
    if wanted.find is not None:
        try:
            columns = decode(buffer, starts + fixed, sizes - fixed, wanted.find)
        except BagError as error:
            raise BagError(f"topic {topic}: {error}") from error
    for name, (offset, dtype) in STORED.items():
        if name in wanted.columns:
            columns[name] = at_every_byte(buffer, np.dtype(dtype))[starts + offset]
    return {name: columns[name] for name in wanted.columns}


def definition_of(bag: BagReader, topic: str) -> Struct:
    """Return the message type of a topic, as the bag defines it."""
    info = bag.topic(topic)
    if info.encoding != "cdr" or info.language != "ros2msg" or not info.definition:
        raise BagError(
            f"topic {topic} ('{info.encoding}') has no ROS 2 message definition: "
            "only its raw messages can be read"
        )
    return parse_definition(info.type_name, info.definition)
