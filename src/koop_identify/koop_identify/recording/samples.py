"""The state's samples in a bag, batch by batch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import LOG_TIME, Columns, iter_tables, list_fields
from koop_bag.bag.files import find_files
from koop_bag.bag.reader import BagReader
from koop_bag.mcap.stored_file import open_stored
from koop_core.config.fields import Source, parse_source
from koop_core.config.parameter import ConfigError
from koop_core.errors import InputError

STAMP, STEP = "header.stamp", "step"


def recorded_source(text: str) -> Source:
    """Read `/topic:field,field` of a bag: numbers (`position[0]`) and arrays, whole (`x`).

    >>> recorded_source("/joint_states:position[0],velocity[0]").topic
    '/joint_states'

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the text is not such a source, or its topic is not a full name.
    """
    source = parse_source(text)
    if not source.topic.startswith("/"):
        raise ConfigError(f"{text!r}: a bag knows topics by their full names: /topic")
    return source


@dataclass(frozen=True)
class Batch:
    """Consecutive samples."""

    time: NDArray[np.int64]
    """Shape (M,): stamp, or time of reception where there is none [ns]."""
    step: NDArray[np.int64] | None
    """Shape (M,): step index, where the message has one."""
    x: NDArray[np.float64]
    """Shape (M, n): state."""
    stamped: bool = True
    """Whether the time is the stamp."""


def batches(bag: BagReader, source: Source) -> Iterator[Batch]:
    """Yield the samples of a bag in the order of recording.

    Their time is the stamp where there is one, else that of reception.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag has no such topic or field, or a field has another length now and then.
    koop_core.errors.InputError
        If a field holds text.
    """
    names = set(list_fields(bag, source.topic))
    fields = [*dict.fromkeys((*source.names, *(names & {STAMP, STEP}), LOG_TIME))]
    first, stamped = True, STAMP in names
    for _, columns in iter_tables(bag, {source.topic: fields}):
        if first:
            stamped = stamped and bool(columns[STAMP][0])  # a source that never stamps writes zeros
            first = False
        yield Batch(
            columns[STAMP if stamped else LOG_TIME].astype(np.int64),
            columns[STEP].astype(np.int64) if STEP in names else None,
            stack_numbers(columns, source.names),
            stamped,
        )


def stack_numbers(columns: Columns, names: Sequence[str]) -> NDArray[np.float64]:
    """Return fields of a topic side by side, shape (M, n).

    Raises
    ------
    koop_core.errors.InputError
        If a field holds text.
    """
    for name in names:
        if columns[name].dtype == object:
            raise InputError(f"field '{name}' holds text: choose a number or an array of numbers")
    return np.column_stack([columns[name] for name in names]).astype(np.float64, copy=False)


def state_names(source: Source, n: int) -> tuple[str, ...]:
    """Return a name for each of the n numbers: the field, with its index where it is an array."""
    if n == len(source.names):
        return tuple(map(_plain, source.names))
    name = _plain(source.names[0]) if len(source.names) == 1 else "x"
    return tuple(f"{name}{i}" for i in range(n))


def _plain(field: str) -> str:
    return field.replace("[", "").replace("]", "").replace(".", "_")


def sha256(path: Path) -> str:
    """Return the hash over the bytes of a bag's files, hexadecimal."""
    digest = hashlib.sha256()
    for file in find_files(path):
        with open_stored(file) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
