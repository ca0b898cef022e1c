"""A bag as tables for other programs: one CSV or Parquet file a topic, in batches."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import ExitStack
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
    kind: str,
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
    kind : str
        `csv` or `parquet`.
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
        path = folder / f"{name.strip('/').replace('/', '.')}.{kind}"
        try:
            extent = measure(bag, name)
        except BagError as error:
            warn(f"{name} is left out: {error}")
            continue
        for field in extent.left_out:
            warn(f"{name}: {field} is left out, it is too long or a wide string")
        _write(bag, name, extent, path, kind)
        written[name] = path
    return written


def _write(bag: BagReader, topic: str, extent: Extent, path: Path, kind: str) -> None:
    try:
        import pyarrow as pa
        import pyarrow.csv
        import pyarrow.parquet
    except ImportError as error:
        raise BagError(f"an export needs pyarrow ({error}): pip install pyarrow") from None
    stored = {name: np.dtype(text) for name, (_, text) in STORED.items()}
    columns: dict[str, np.dtype[Any]] = stored | extent.fields
    types = {
        name: pa.string() if dtype.kind == "O" else pa.from_numpy_dtype(dtype)
        for name, dtype in columns.items()
    }
    schema = pa.schema([pa.field(name, item) for name, item in types.items()])
    with ExitStack() as stack:
        if kind == "parquet":
            writer = stack.enter_context(pa.parquet.ParquetWriter(path, schema, compression="zstd"))
        else:
            writer = stack.enter_context(pa.csv.CSVWriter(path, schema))
        for batch in iter_columns(bag, topic, list(columns)):
            arrays = [_arrow(batch[name], item, pa) for name, item in types.items()]
            writer.write_batch(pa.record_batch(arrays, schema=schema))


def _arrow(values: NDArray[Any], wanted: Any, pa: Any) -> Any:
    """An Arrow array; an element that its message does not have is null."""
    if values.dtype == object:
        absent = np.fromiter((value != value for value in values), bool, len(values))
        return pa.array(values, type=wanted, mask=absent)
    if values.dtype.kind == "f" and not pa.types.is_floating(wanted):
        absent = np.isnan(values)
        return pa.array(np.where(absent, 0, values).astype(wanted.to_pandas_dtype()), mask=absent)
    return pa.array(values, type=wanted)
