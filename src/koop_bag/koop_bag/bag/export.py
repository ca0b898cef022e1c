"""A bag as tables for other programs: one CSV file a topic, in batches."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koop_bag.bag.columns import STORED, iter_columns
from koop_bag.bag.extent import Extent, measure
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError


def export(
    bag: BagReader,
    folder: Path,
    topics: Collection[str] | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> dict[str, Path]:
    """Write one file a topic.

    Parameters
    ----------
    bag : BagReader
        The bag.
    folder : path
        Where the files come to lie; created.
    topics : collection of str, optional
        Only these.
    warn : callable
        Told in one line what a file does not hold.

    Returns
    -------
    dict of str to path
        Files by topic. A topic without messages, or whose messages can't be decoded, has none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = {}
    for name in topics or [topic.name for topic in bag.topics]:
        if not bag.topic(name).count:
            warn(f"{name} has no messages")
            continue
        path = folder / f"{name.strip('/').replace('/', '.')}.csv"
        try:
            extent = measure(bag, name)
        except BagError as error:
            warn(f"{name} is left out: {error}")
            continue
        for field in extent.left_out:
            warn(f"{name}: {field} is left out, it is too long or a wide string")
        _write(bag, name, extent, path)
        written[name] = path
    return written


def _write(bag: BagReader, topic: str, extent: Extent, path: Path) -> None:
    columns = {name: np.dtype(text) for name, (_, text) in STORED.items()} | extent.fields
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for batch in iter_columns(bag, topic, list(columns)):
            cells = [_cells(batch[name], dtype) for name, dtype in columns.items()]
            writer.writerows(zip(*cells, strict=True))


def _cells(values: NDArray[Any], dtype: np.dtype[Any]) -> list[Any]:
    """Return the cells of a column; an element that its message does not have is empty."""
    if values.dtype == dtype and dtype.kind != "O":
        return list(values.tolist())
    return ["" if value != value else dtype.type(value) for value in values.tolist()]
