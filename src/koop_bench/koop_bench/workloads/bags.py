"""One measurement of `koop bench bags`, in a process of its own.

Run as ``python workloads/bags.py OPERATION LIBRARY FOLDER [COUNT RATE]``; prints a line of JSON:
processor time [s], peak of memory above what was there before [B], messages, bytes written. COUNT
messages are written, at RATE steps a second by their stamps. `rosbags` is a requirement of tests
and of this benchmark only.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

BEGIN = 1_700_000_000_000_000_000  # [ns]
CHUNK = 64 * 1024  # [B] as our own writer has it


class Message(NamedTuple):
    """What a writer is given."""

    topic: str
    time: int
    data: bytes


def messages(folder: Path, rate: float) -> Iterator[Message]:
    """The messages of the bag that is compared, at so many steps a second."""
    from koop_bag.bag.reader import BagReader

    with BagReader(folder / "source") as bag:
        topics = [topic.name for topic in bag.topics]
        for number, item in enumerate(bag.messages()):
            now = BEGIN + round(number // len(topics) * 1e9 / rate)
            yield Message(item.topic, now, item.data)


def types(folder: Path) -> dict[str, Any]:
    """The message definitions by topic."""
    from koop_bag.bag.reader import BagReader
    from koop_bag.cdr.schema import load_schema

    with BagReader(folder / "source") as bag:
        return {topic.name: load_schema(topic.type_name) for topic in bag.topics}


# -- writing: each takes the folder, what is in it, the messages, and whether to close at the end


def write_koop_bag(folder: Path, schemas: dict[str, Any], rows: Iterable[Message]) -> Any:
    from koop_bag.bag.writer import BagWriter

    writer = BagWriter(folder / "out")
    channels = {topic: writer.add_topic(topic, schema) for topic, schema in schemas.items()}
    # as the recorder does it: what arrived in 20 ms at once
    waiting = []
    for topic, now, data in rows:
        waiting.append((now, channels[topic], now, data))
        if len(waiting) == 16:
            writer.write_many(waiting)
            waiting.clear()
    writer.write_many(waiting)
    return writer.close


def write_mcap(
    folder: Path, schemas: dict[str, Any], rows: Iterable[Message], chunk: int = CHUNK
) -> Any:
    from mcap.writer import Writer

    (folder / "out").mkdir()
    stream = open(folder / "out" / "out_0.mcap", "wb", buffering=0)  # noqa: SIM115
    writer = Writer(stream, chunk_size=chunk)
    writer.start("ros2")
    channels = {}
    for topic, schema in schemas.items():
        number = writer.register_schema(schema.name, "ros2msg", schema.text.encode())
        channels[topic] = writer.register_channel(topic, "cdr", number)
    for sequence, (topic, now, data) in enumerate(rows):
        writer.add_message(channels[topic], now, data, now, sequence)
    return writer.finish


def write_mcap_small(folder: Path, schemas: dict[str, Any], rows: Iterable[Message]) -> Any:
    return write_mcap(folder, schemas, rows, 6 * 1024)


def write_mcap_default(folder: Path, schemas: dict[str, Any], rows: Iterable[Message]) -> Any:
    return write_mcap(folder, schemas, rows, 1024 * 1024)


def write_rosbags(folder: Path, schemas: dict[str, Any], rows: Iterable[Message]) -> Any:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(folder / "out", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.open()
    connections = {}
    for topic, schema in schemas.items():
        store.register(get_types_from_msg(schema.text.split("=" * 80)[0], schema.name))
        connections[topic] = writer.add_connection(topic, schema.name, typestore=store)
    for topic, now, data in rows:
        writer.write(connections[topic], now, data)
    return writer.close


# -- reading: all fields of all messages, as one array a field


def columns_koop_bag(folder: Path) -> int:
    from koop_bag.bag.columns import read_tables
    from koop_bag.bag.reader import BagReader

    with BagReader(folder / "source") as bag:
        tables = read_tables(bag, {topic.name: None for topic in bag.topics})
    return sum(len(next(iter(table.values()))) for table in tables.values())


def columns_rosbags(folder: Path) -> int:
    from rosbags.highlevel import AnyReader

    with AnyReader([folder / "source"]) as reader:
        decoded = (
            (item.topic, reader.deserialize(raw, item.msgtype))
            for item, _, raw in reader.messages()
        )
        return _gather(decoded)


def columns_mcap_ros2(folder: Path) -> int:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    (path,) = (folder / "source").glob("*.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return _gather((c.topic, decoded) for _, c, _, decoded in reader.iter_decoded_messages())


def _gather(decoded: Iterable[tuple[str, Any]]) -> int:
    import numpy as np

    columns: dict[tuple[str, str], list[Any]] = {}
    count = 0
    for topic, message in decoded:
        count += 1
        header = message.header
        stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        columns.setdefault((topic, "stamp"), []).append(stamp)
        columns.setdefault((topic, "frame_id"), []).append(header.frame_id)
        for name in _fields(message):
            columns.setdefault((topic, name), []).append(getattr(message, name))
    arrays = {key: np.array(values) for key, values in columns.items()}
    assert all(len(array) for array in arrays.values())
    return count


def _fields(message: Any, known: dict[type, list[str]] = {}) -> list[str]:  # noqa: B006
    kind = type(message)
    if kind not in known:
        names = getattr(message, "__slots__", None) or vars(message)
        known[kind] = [name.strip("_") for name in names if name.strip("_").islower()]
        known[kind] = [n for n in known[kind] if n not in ("header", "msgtype")]
    return known[kind]


# -- reading: the serialized messages


def raw_koop_bag(folder: Path) -> int:
    from koop_bag.bag.reader import BagReader

    with BagReader(folder / "source") as bag:
        return sum(1 for _ in bag.messages())


def raw_mcap(folder: Path) -> int:
    from mcap.reader import make_reader

    (path,) = (folder / "source").glob("*.mcap")
    with path.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(log_time_order=False))


def raw_rosbags(folder: Path) -> int:
    from rosbags.highlevel import AnyReader

    with AnyReader([folder / "source"]) as reader:
        return sum(1 for _ in reader.messages())


# -- a file that ends in mid-chunk, as a killed recorder leaves it


def torn_koop_bag(folder: Path) -> int:
    from koop_bag.bag.reader import BagReader

    with BagReader(folder / "torn" / "torn_0.mcap") as bag:
        return sum(1 for _ in bag.messages())


def torn_mcap(folder: Path) -> int:
    from mcap.exceptions import McapError
    from mcap.records import Message as MessageRecord
    from mcap.stream_reader import StreamReader  # the readers that know topics give up

    count = 0
    with (folder / "torn" / "torn_0.mcap").open("rb") as stream, suppress(McapError):
        for record in StreamReader(stream).records:
            count += isinstance(record, MessageRecord)
    return count


def torn_rosbags(folder: Path) -> int:
    from rosbags.highlevel import AnyReader

    count = 0
    # whatever it says of a file without an end and a folder without metadata.yaml
    with suppress(Exception), AnyReader([folder / "torn" / "torn_0.mcap"]) as reader:
        for _ in reader.messages():
            count += 1
    return count


def main(
    operation: str, library: str, folder: Path, count: int = sys.maxsize, rate: float = 200.0
) -> None:
    """Measure one operation of one library."""
    action: Callable[..., Any] = globals()[
        f"{'write' if operation == 'kill' else operation}_{library}"
    ]
    if operation in ("write", "kill"):
        schemas, rows = types(folder), list(islice(messages(folder, rate), count))
        given: tuple[Any, ...] = (schemas, rows)
    else:
        given = ()
    _warm_up(library)
    before, begin = _peak(), time.process_time()
    result = action(folder, *given)
    if operation == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if operation == "write":
        result()
        result = len(given[1])
    elapsed = time.process_time() - begin
    stored = sum(path.stat().st_size for path in folder.glob("out/*.mcap"))
    said = {"time": elapsed, "memory": _peak() - before, "messages": result, "stored": stored}
    print(json.dumps(said))


def _warm_up(library: str) -> None:
    """Import what the library imports: that is not its speed."""
    modules = {
        "koop_bag": ["koop_bag.bag.columns", "koop_bag.bag.writer"],
        "mcap": ["mcap.reader", "mcap.stream_reader", "mcap.writer"],
        "mcap_default": ["mcap.writer"],
        "mcap_small": ["mcap.writer"],
        "mcap_ros2": ["mcap.reader", "mcap_ros2.decoder", "numpy"],
        "rosbags": ["rosbags.highlevel", "rosbags.rosbag2", "numpy"],
    }
    for name in modules[library]:
        if importlib.util.find_spec(name.partition(".")[0]) is None:
            sys.exit(f"{name.partition('.')[0]} is not installed")
        importlib.import_module(name)


def _peak() -> int:
    """Most memory that this process has held [B]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:]))
