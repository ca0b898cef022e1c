"""The messages of a bag in time order."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

from koop_bag.bag.reader import RawMessage

REORDER_WINDOW = 200_000_000
"""How far [ns] behind a later one a message may lie in the file: recorders write in batches."""


def in_time_order(messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
    """Messages sorted by log time, equal times in the order of the file, with bounded memory.

    A message that lies further than `REORDER_WINDOW` from its place comes late, not never.
    """
    waiting: list[tuple[int, int, RawMessage]] = []
    newest = 0
    for number, message in enumerate(messages):
        newest = max(newest, message.log_time)
        heapq.heappush(waiting, (message.log_time, number, message))
        while waiting and waiting[0][0] <= newest - REORDER_WINDOW:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
