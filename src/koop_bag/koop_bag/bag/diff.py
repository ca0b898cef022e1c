"""Two bags compared: topic by topic, message by message, field by field."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from koop_bag.bag.column_diff import column_diff
from koop_bag.bag.columns import read_columns
from koop_bag.bag.extent import measure
from koop_bag.bag.reader import BagReader, BagTopic
from koop_bag.bag.topics import is_common
from koop_bag.cdr.definition import parse_definition
from koop_bag.cdr.header import has_step
from koop_bag.cdr.schema import MessageSchema
from koop_bag.errors import BagError


@dataclass(frozen=True)
class FieldDiff:
    """Where one field differs.

    Attributes
    ----------
    name : str
        Field.
    count : int
        Messages in which it differs.
    first : int
        Step, or number, of the first of them.
    values : tuple
        Values in the two bags there.
    largest : float
        Largest difference: infinite where only one side is a number, NaN for text.
    largest_at : int
        Step, or number, of that message.
    """

    name: str
    count: int
    first: int
    values: tuple[Any, Any]
    largest: float
    largest_at: int


@dataclass
class TopicDiff:
    """How one topic differs.

    Attributes
    ----------
    topic : str
        Its name.
    by_step : bool
        Whether messages of the same step were compared; else the n-th with the n-th.
    compared : int
        Messages that both bags have.
    only_a, only_b : int
        Messages that only one bag has.
    problem : str
        Why nothing was compared, empty otherwise.
    fields : list of FieldDiff
        Fields that differ.
    """

    topic: str
    by_step: bool = False
    compared: int = 0
    only_a: int = 0
    only_b: int = 0
    problem: str = ""
    fields: list[FieldDiff] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether there is no difference."""
        return not (self.only_a or self.only_b or self.problem or self.fields)


def compare(
    a: BagReader,
    b: BagReader,
    topics: Collection[str] | None = None,
    *,
    ignore: Collection[str] = (),
    tolerance: float = 0.0,
) -> Iterator[TopicDiff]:
    """Compare two bags; holds one topic of both in memory.

    Parameters
    ----------
    a, b : BagReader
        The bags.
    topics : collection of str, optional
        Default: all but the topics that every node publishes by itself, which always differ.
    ignore : collection of str
        Fields that may differ, such as `header.stamp`.
    tolerance : float
        Largest difference of two numbers that counts as equal.

    Notes
    -----
    Of repeated steps (a state sent again) the first is compared. Receive times, send times and
    sequence numbers are those of the recording, not of the message, and are not compared.
    """
    names = dict.fromkeys(topic.name for bag in (a, b) for topic in bag.topics)
    for name in topics or [name for name in names if not is_common(name)]:
        both = [next((t for t in bag.topics if t.name == name), None) for bag in (a, b)]
        if None in both:
            missing = (a, b)[both.index(None)]
            yield TopicDiff(name, problem=f"{missing.path} has no such topic")
        else:
            try:
                yield _compare_topic(a, b, name, ignore, tolerance)
            except BagError as error:
                yield TopicDiff(name, problem=str(error))


def _compare_topic(
    a: BagReader, b: BagReader, name: str, ignore: Collection[str], tolerance: float
) -> TopicDiff:
    first, second = a.topic(name), b.topic(name)
    if first.type_name != second.type_name:
        return TopicDiff(name, problem=f"types {first.type_name} and {second.type_name}")
    if _definition(first) != _definition(second):
        return TopicDiff(name, problem=f"two versions of {first.type_name}")
    if not (first.count and second.count):
        return TopicDiff(name, only_a=first.count, only_b=second.count)
    extents = [measure(bag, name) for bag in (a, b)]
    ignored = {item for item in extents[0].fields | extents[1].fields if _matches(item, ignore)}
    fields = [item for item in extents[0].fields | extents[1].fields if item not in ignored]
    by_step = has_step(MessageSchema(first.type_name, first.definition, ""))
    wanted = list(dict.fromkeys([*fields, *(["step"] if by_step else [])]))
    columns = [read_columns(bag, name, wanted) for bag in (a, b)]
    key_a, key_b = (
        c["step"] if by_step else np.arange(t.count)
        for c, t in zip(columns, (first, second), strict=True)
    )
    common, rows_a, rows_b = np.intersect1d(key_a, key_b, return_indices=True)
    result = TopicDiff(name, by_step, common.size)
    result.only_a, result.only_b = (np.unique(key).size - common.size for key in (key_a, key_b))
    for item in fields:
        values = columns[0][item][rows_a], columns[1][item][rows_b]
        diff = column_diff(*values, tolerance=tolerance)
        if diff is not None:
            result.fields.append(
                FieldDiff(
                    item,
                    diff.count,
                    int(common[diff.first]),
                    (values[0][diff.first], values[1][diff.first]),
                    diff.largest,
                    int(common[diff.largest_at]),
                )
            )
    left_out = [item for item in extents[0].left_out if not _matches(item, ignore)]
    if left_out:
        data_a, data_b = ([m.data for m in bag.messages([name])] for bag in (a, b))
        pairs = zip(rows_a, rows_b, strict=True)
        unequal = np.array([_bytes(data_a[i]) != _bytes(data_b[j]) for i, j in pairs], bool)
        if unequal.any():
            at, what = int(common[np.argmax(unequal)]), ", ".join(left_out)
            count = int(unequal.sum())
            result.fields.append(FieldDiff(what, count, at, ("bytes", "bytes"), math.nan, at))
    return result


def _matches(name: str, patterns: Collection[str]) -> bool:
    """Whether a field is one of those named, or an element or member of one."""
    return any(name == item or name.startswith((f"{item}.", f"{item}[")) for item in patterns)


def _definition(topic: BagTopic) -> object:
    return parse_definition(topic.type_name, topic.definition) if topic.definition else None


def _bytes(data: bytes) -> bytes:
    """A message as DDS hands it on, filled up to a multiple of four bytes."""
    return data + bytes(-len(data) % 4)
