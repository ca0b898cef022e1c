"""The state's samples in a bag, batch by batch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import LOG_TIME, iter_columns, list_fields
from koop_bag.bag.files import find_files
from koop_bag.bag.reader import BagReader
from koop_bag.mcap.stored_file import open_stored
from koop_core.config.fields import format_field, parse_source

STAMP, STEP = "header.stamp", "step"


@dataclass(frozen=True)
class StateSpec:
    """Which numbers of which topic are the state.

    Attributes
    ----------
    topic : str
        Full name of the topic.
    fields : tuple of str
        Numbers (`position[0]`) and arrays, of which every element counts (`x`).
    """

    topic: str
    fields: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> StateSpec:
        """Read `/topic:field,field`.

        >>> StateSpec.parse("/joint_states:position[0],velocity[0]").fields
        ('position[0]', 'velocity[0]')

        Raises
        ------
        ValueError
            If the text names no topic or no field.
        """
        source = parse_source(text)
        if not source.topic.startswith("/"):
            raise ValueError(f"state {text!r}: a bag knows topics by their full names: /topic")
        names = tuple(map(format_field, source.fields))
        if len(set(names)) < len(names):
            raise ValueError(f"state {text!r}: a field stands there twice")
        return cls(source.topic, names)

    def __str__(self) -> str:
        return f"{self.topic}:{','.join(self.fields)}"


@dataclass(frozen=True)
class Batch:
    """Consecutive samples.

    Attributes
    ----------
    index : int
        Position of the first one among the topic's messages.
    time : ndarray of int64, shape (M,)
        Stamp, or time of reception where there is none [ns].
    step : ndarray of int64, shape (M,), or None
        Step index, where the message has one.
    x : ndarray, shape (M, n)
        State.
    stamped : bool
        Whether the time is the stamp.
    """

    index: int
    time: NDArray[np.int64]
    step: NDArray[np.int64] | None
    x: NDArray[np.float64]
    stamped: bool = True


def batches(bag: BagReader, spec: StateSpec, by_stamp: bool = True) -> Iterator[Batch]:
    """Yield the samples of a bag in the order of recording.

    Their time is the stamp where there is one, unless ``by_stamp`` is False, else that of
    reception.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag has no such topic or field, or a field has another length now and then.
    """
    known = set(list_fields(bag, spec.topic))
    wanted = [*dict.fromkeys((*spec.fields, *(known & {STAMP, STEP}), LOG_TIME))]
    index, stamped = 0, by_stamp and STAMP in known
    for columns in iter_columns(bag, spec.topic, wanted):
        if not index:
            stamped = stamped and bool(columns[STAMP][0])  # a source that never stamps writes zeros
        x = np.column_stack([columns[name] for name in spec.fields]).astype(np.float64, copy=False)
        yield Batch(
            index,
            columns[STAMP if stamped else LOG_TIME].astype(np.int64),
            columns[STEP].astype(np.int64) if STEP in known else None,
            x,
            stamped,
        )
        index += x.shape[0]


def state_names(spec: StateSpec, n: int) -> tuple[str, ...]:
    """Return a name for each of the n numbers: the field, with its index where it is an array.

    Raises
    ------
    ValueError
        If several fields are arrays, so that the numbers cannot be told apart.
    """
    arrays = n - len(spec.fields) + 1
    if arrays == 1:
        return tuple(_plain(name) for name in spec.fields)
    if len(spec.fields) == 1:
        return tuple(f"{_plain(spec.fields[0])}{i}" for i in range(n))
    raise ValueError(f"{n} numbers in {spec}: name them with --names")


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
