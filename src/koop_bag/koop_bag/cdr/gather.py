"""Takes fields out of many serialized messages at once."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.cdr.layout import Layout, Span
from koop_bag.errors import BagError
from koop_core.cdr import ENCAPSULATION

_LITTLE_ENDIAN_CDR = 0x0100  # bytes 00 01
_MAX_GROUPS = 64
"""After so many layouts in a batch, looking for messages of equal layout costs more than it saves.
"""

Bytes = NDArray[np.uint8]
Offsets = NDArray[np.int64]


def at_every_byte(buffer: Bytes, dtype: "np.dtype[Any]") -> NDArray[Any]:
    """Return the buffer seen as one value per byte offset.

    Values at any, unaligned, offsets are plain indexing then.
    """
    values: NDArray[Any] = np.ndarray(
        (max(0, len(buffer) - dtype.itemsize + 1),), dtype, buffer, strides=(1,)
    )
    return values


def decode(
    buffer: Bytes, starts: Offsets, sizes: Offsets, find: Callable[[bytes], Layout]
) -> dict[str, NDArray[Any]]:
    """Columns of messages that lie in a buffer, of layouts that ``find`` finds.

    ``starts`` and ``sizes``, shape (n,), say where each begins, encapsulation included, and its
    length [B].
    """
    if (sizes < ENCAPSULATION).any():
        raise BagError("a message is cut short: not even the mark of its encoding is there")
    heads = at_every_byte(buffer, np.dtype("<u2"))[starts]
    if (heads != _LITTLE_ENDIAN_CDR).any():
        raise BagError("a message is not in little-endian CDR; other encodings are not supported")
    columns: dict[str, NDArray[Any]] = {}
    groups = 0
    for size in np.unique(sizes):
        todo = np.flatnonzero(sizes == size)
        while todo.size:
            begin = int(starts[todo[0]])
            layout = find(buffer[begin : begin + int(size)].tobytes())
            groups += 1
            same = _matching(buffer, starts, todo, layout) if groups < _MAX_GROUPS else todo[:1]
            # An element beyond the end of its array has no span.
            for name, span in layout.spans.items():
                values = _take(buffer, starts[same], span) if span else np.full(same.size, np.nan)
                column = columns.get(name)
                if column is None:
                    column = np.empty((len(starts), *values.shape[1:]), values.dtype)
                if column.shape[1:] != values.shape[1:]:
                    check_lengths(name, (column, values))
                if column.dtype != values.dtype:  # NaN for some, numbers or strings for others
                    column = column.astype(np.result_type(column.dtype, values.dtype))
                column[same] = values
                columns[name] = column
            todo = todo[1:] if same.size == 1 else np.setdiff1d(todo, same, assume_unique=True)
    return columns


def _matching(buffer: Bytes, starts: Offsets, candidates: Offsets, layout: Layout) -> Offsets:
    words = at_every_byte(buffer, np.dtype("<u4"))
    for offset, value in layout.guards:
        candidates = candidates[words[starts[candidates] + offset] == value]
    return candidates


def _take(buffer: Bytes, starts: Offsets, span: Span) -> NDArray[Any]:
    where = starts + span.offset
    if span.dtype.kind == "V":
        seconds = at_every_byte(buffer, np.dtype("<i4"))[where].astype(np.int64)
        nanoseconds = at_every_byte(buffer, np.dtype("<u4"))[where + 4]
        return np.asarray(seconds * 1_000_000_000 + nanoseconds)
    if span.dtype.kind == "S":
        return _strings(buffer, where, span.count or 0)
    if span.count is not None:
        where = where[:, None] + np.arange(span.count) * span.dtype.itemsize
    if span.dtype.kind == "b":  # any byte but 0 is true, also for a careless sender
        return np.asarray(buffer[where] != 0)
    return np.asarray(at_every_byte(buffer, span.dtype)[where])


def _strings(buffer: Bytes, where: Offsets, size: int) -> NDArray[Any]:
    if size == 0:
        return np.full(len(where), "", dtype=object)
    raw = at_every_byte(buffer, np.dtype(f"V{size}"))[where]
    values, index = np.unique(raw, return_inverse=True)
    texts = np.array([value.tobytes().decode("utf-8", "replace") for value in values], dtype=object)
    return np.asarray(texts[index.reshape(-1)])


def check_lengths(name: str, arrays: Iterable[NDArray[Any]]) -> None:
    """Raise BagError unless a field's arrays have the same number of elements."""
    shapes = sorted({array.shape[1:] for array in arrays})
    if len(shapes) > 1:
        lengths = " and ".join(str(shape[0]) for shape in shapes)
        raise BagError(
            f"'{name}' has {lengths} elements in different messages: "
            f"choose elements, such as {name}[0]"
        )
