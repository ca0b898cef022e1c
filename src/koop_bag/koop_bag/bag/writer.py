"""Writes a rosbag2 bag (ROS 2 Jazzy, MCAP): a folder of `<name>_N.mcap` and `metadata.yaml`."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from mcap.records import Channel, Schema

from koop_bag.bag.earlier import ALARMS, EarlierRuns, lock, name_of_alarm
from koop_bag.bag.metadata import OfferedQos, TopicRecord, bag_map, dump
from koop_bag.cdr.schema import MessageSchema
from koop_bag.errors import BagError, BagWriteError, writing
from koop_bag.mcap.chunk import Batch, ChunkBuffer, Row, batch_of
from koop_bag.mcap.file_writer import FileRecord, McapFileWriter
from koop_core import whole_file
from koop_core.config.parameter import Settings, parameter
from koop_core.errors import LiveError

Result = TypeVar("Result")
RING = 20
"""Files of a ring and its alarms: what is dropped at once is one part of so many."""
CHUNK = 64 * 1024
"""A chunk goes to disk when it holds this much [B], if not before."""
RESERVE = 100_000_000
"""Free space that a disk should have where no size of a file says more [B]."""


@dataclass(frozen=True)
class WriterOptions(Settings):
    """How a bag is written."""

    compression: str = parameter("zstd", "of the file's chunks", choices=("none", "zstd"))
    chunk_seconds: float = parameter(
        0.1,
        "a chunk goes to disk when its first message is this old: what a killed recorder can lose "
        "at low rates",
        unit="s",
        low=0.0,
    )
    split_bytes: int = parameter(
        0, "start the next file when this one is that large; 0: never", unit="B", low=0
    )
    keep_bytes: int = parameter(
        0, "drop the oldest files so that all take no more; 0: keep all", unit="B", low=0
    )
    keep_seconds: float = parameter(
        0.0, "drop files whose last message is older than this; 0: keep all", unit="s", low=0.0
    )

    @property
    def is_ring(self) -> bool:
        """Whether old files are dropped."""
        return bool(self.keep_bytes or self.keep_seconds)

    @property
    def file_bytes(self) -> int:
        """Size at which the next file begins [B]; 0: never."""
        return self.split_bytes or self.keep_bytes // RING

    @property
    def reserve(self) -> int:
        """Free space below which a disk is nearly full [B]: what the next file takes."""
        return self.file_bytes or RESERVE

    @property
    def file_time(self) -> int:
        """Time after which the next file begins [ns]; 0: never."""
        return int(self.keep_seconds * 1e9 / RING)


class BagWriter(AbstractContextManager["BagWriter"]):
    """A bag being recorded.

    Its folder is created and must not hold a bag yet; the folder's name is the bag's. The messages
    were recorded with ``ros_distro``, by default this process's. After a `BagWriteError` the bag is
    closed: everything up to the last complete chunk is on the disk, with a summary if there was
    room for it. A ring drops the files of ``earlier`` runs before its own.
    """

    def __init__(
        self,
        folder: str | Path,
        options: WriterOptions | None = None,
        ros_distro: str = "",
        earlier: EarlierRuns | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.options = options or WriterOptions()
        self._earlier = earlier or EarlierRuns()
        self.custom_data: dict[str, str] = {}
        """Entries of the bag's description. Each file has those at the time of its closing;
        :meth:`keep` has it written at once."""
        self.topics: list[TopicRecord] = []
        self._ros_distro = ros_distro or os.environ.get("ROS_DISTRO", "jazzy")
        self._files: list[FileRecord] = []
        self._opened = 0
        self._is_alarm_file = False
        self._alarms: list[FileRecord] = []
        self._dropped: list[Path] = []
        self.alarms_full = False
        """Whether a file around an alarm was dropped, for want of room in `alarms/`."""
        self.closed = False
        with writing(f"create the folder {self.folder}"):
            self.folder.mkdir(parents=True, exist_ok=True)
        if any(self.folder.glob("*.mcap")):
            raise BagWriteError(
                f"{self.folder} already holds a bag: choose another folder, nothing is overwritten"
            )
        self._lock = lock(self.folder) if self.options.is_ring else None
        chunk_age = int(self.options.chunk_seconds * 1e9)
        self._chunk = ChunkBuffer(self.options.compression, CHUNK, chunk_age)
        self._open_file()

    @property
    def bytes_written(self) -> int:
        """Bytes on the disk, without dropped files."""
        return _bytes_of(self._files + self._alarms)

    @property
    def message_count(self) -> int:
        """Messages on the disk, without dropped files."""
        return sum(file.count for file in self._files)

    @property
    def path(self) -> Path:
        """The file being written."""
        return self._file.path

    def add_topic(
        self,
        name: str,
        schema: MessageSchema,
        qos: Sequence[OfferedQos] = (OfferedQos(),),
        encoding: str = "cdr",
    ) -> int:
        """Announce a topic; returns the channel that its messages are written to."""
        self._check_open()
        if any(topic.channel.topic == name for topic in self.topics):
            raise BagError(f"topic {name} is already in the bag")
        schemas = {topic.schema.name: topic.schema for topic in self.topics}
        entry = schemas.get(schema.name) or Schema(
            id=len(schemas) + 1,
            data=schema.text.encode(),
            encoding=schema.encoding,
            name=schema.name,
        )
        channel = Channel(
            id=len(self.topics) + 1,
            topic=name,
            message_encoding=encoding,
            metadata={
                "offered_qos_profiles": dump([item.as_map() for item in qos]),
                "topic_type_hash": schema.type_hash,
            },
            schema_id=entry.id,
        )
        self._guarded(lambda: self._file.add_channel(entry, channel))
        self.topics.append(TopicRecord(entry, channel, tuple(qos)))
        return channel.id

    def write(
        self,
        channel: int,
        log_time: int,
        publish_time: int,
        data: bytes,
        sequence: int | None = None,
    ) -> None:
        """Write one serialized message; times in nanoseconds since the epoch.

        Without a `sequence` the numbers of a channel count on, beginning at 1.
        """
        if sequence is not None:
            self._chunk.number(channel, sequence)
        self.write_many(((log_time, channel, publish_time, data),))

    def write_many(self, rows: Iterable[Row]) -> None:
        """Write messages in the order in which they were received."""
        self.write_batch(batch_of(rows))

    def write_batch(self, batch: Batch) -> None:
        """Write messages that lie in one buffer."""
        self._check_open()
        first, full = self._chunk.add(batch, 0)
        while full:
            self._write_chunk()
            first, full = self._chunk.add(batch, first)

    def flush(self) -> None:
        """Put the chunk in progress on the disk."""
        if not self.closed and self._chunk.size:
            self._write_chunk()

    def flush_due(self, now: int) -> None:
        """Put the chunk in progress on the disk if its time is up; `now` in ns since the epoch."""
        if self._chunk.is_due(now):
            self.flush()

    def note_alarm(self) -> None:
        """Keep the file in progress, the one before and the next for good.

        A ring moves such a file into `alarms/` instead of dropping it, while there is room: the
        first alarms stay, and a guard that trips again and again cannot empty the ring. A user who
        takes files away makes room.
        """
        for record in self._files[-2:]:
            record.of_alarm = True
        self._is_alarm_file = True
        names = [*(record.path for record in self._files[-2:]), self._name(self._opened)]
        name_of_alarm(self.folder, names)

    def make_room(self, free: int) -> None:
        """Drop the oldest files of a ring while its disk is nearly full.

        ``free`` [B] is what the disk has. The newest whole file stays; if the one in progress has
        grown large meanwhile, it becomes that one.
        """
        options = self.options
        if self.closed or not options.is_ring or free >= options.reserve:
            return
        self.flush()
        if self._file.record.size >= 16 * CHUNK:
            self._guarded(self._next_file)
        dropped = False
        while free < options.reserve and (self._earlier.files or len(self._files) > 2):
            free += self._guarded(self._drop_oldest)
            dropped = True
        if dropped:
            self._guarded(lambda: self._remove_dropped(self._files[:-1]))
            self._guarded(self._describe)

    def keep(self, custom_data: Mapping[str, str]) -> None:
        """Add to the custom data and write it at once, so that it outlives a crash."""
        self._check_open()
        self.custom_data.update(custom_data)
        self._guarded(self._describe)

    def close(self) -> None:
        """Write the last chunk, the summary and `metadata.yaml`. A second call does nothing."""
        if self.closed:
            return
        self.flush()
        self._guarded(self._finish_file)
        self.closed = True
        self._write_description(self._files)
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _name(self, number: int) -> str:
        return f"{self.folder.name}_{number}.mcap"

    def __exit__(self, *error: object) -> None:
        self.close()

    def _open_file(self) -> None:
        self._file = McapFileWriter(self.folder / self._name(self._opened))
        self._opened += 1
        self._files.append(self._file.record)
        self._file.record.of_alarm, self._is_alarm_file = self._is_alarm_file, False
        for schema, channel, _ in self.topics:
            self._file.add_channel(schema, channel)
        self._describe()

    def _write_chunk(self) -> None:
        chunk, record, options = self._chunk, self._file.record, self.options
        self._guarded(lambda: self._file.add_chunk(chunk))
        chunk.clear()
        too_large = 0 < options.file_bytes <= record.size
        if too_large or 0 < options.file_time <= record.end - record.start:
            self._guarded(self._next_file)

    def _next_file(self) -> None:
        self._finish_file()
        self._chunk.not_before = self._files[-1].end
        while (self._earlier.files or len(self._files) > 1) and self._is_too_much():
            self._drop_oldest()
        if self.options.is_ring:
            self._remove_dropped(self._files)
        self._open_file()

    def _is_too_much(self) -> bool:
        """Whether the closed files and one more like the last are more than is to be kept."""
        last, options = self._files[-1], self.options
        earlier = self._earlier
        taken = _bytes_of(self._files + self._alarms) + earlier.size + earlier.kept
        too_large = 0 < options.keep_bytes < taken + last.size
        age = last.end - (earlier.end() if earlier.files else self._files[0].end)
        return too_large or 0 < options.keep_seconds * 1e9 < age

    def _drop_oldest(self) -> int:
        """Give up the oldest file, or keep it apart; return the bytes that become free.

        A kill at any time leaves the file in a bag that describes it: it is gone from here only
        after it was described in `alarms/`, and after it is no longer described here.
        """
        if self._earlier.files:
            return self._earlier.drop()
        record = self._files.pop(0)
        path, alarms = self.folder / record.path, self.folder / ALARMS
        self._dropped.append(path)
        if not record.of_alarm:
            return record.size
        self._alarms = [item for item in self._alarms if (alarms / item.path).exists()]
        self.alarms_full = not self._has_room_for(record)
        if self.alarms_full:
            return record.size
        with writing(f"keep {path}"):
            alarms.mkdir(exist_ok=True)
            _link(path, alarms / path.name)
        self._alarms.append(record)
        self._write_description(self._alarms, alarms)
        return 0

    def _has_room_for(self, record: FileRecord) -> bool:
        """Whether a file around an alarm may be kept for good."""
        if self.options.keep_bytes:
            kept = _bytes_of(self._alarms) + self._earlier.kept
            return 2 * (kept + record.size) <= self.options.keep_bytes
        return len(self._alarms) < RING // 2

    def _remove_dropped(self, left: Sequence[FileRecord]) -> None:
        """Describe the whole files that are left, then remove those that were dropped."""
        try:
            self._write_description(left)
        except BagWriteError:  # on a full disk, only what is removed makes room
            self._unlink_dropped()
            self._write_description(left)
        self._unlink_dropped()

    def _unlink_dropped(self) -> None:
        for path in self._dropped:
            with writing(f"drop {path}"):
                path.unlink(missing_ok=True)  # a user may have made room
        self._dropped.clear()

    def _finish_file(self) -> None:
        self._describe()
        self._file.finish()

    def _describe(self) -> None:
        """Write the bag's description; of several in a file, readers take the last."""
        text = dump(self._description(self._files))
        self._file.add_metadata("rosbag2", {"serialized_metadata": text})

    def _description(self, files: Sequence[FileRecord]) -> dict[str, object]:
        return bag_map(self.topics, files, self.custom_data, self._ros_distro)

    def _write_description(self, files: Sequence[FileRecord], folder: Path | None = None) -> None:
        path = (folder or self.folder) / "metadata.yaml"
        text = dump({"rosbag2_bagfile_information": self._description(files)})
        try:
            whole_file.write_text(path, text)
        except LiveError as error:
            path.unlink(missing_ok=True)  # it does not say what is there now
            raise BagWriteError(f"{error}; `koop bag recover` makes it again") from error

    def _guarded(self, action: Callable[[], Result]) -> Result:
        """Do a write; if it fails, close the bag as well as the disk allows before raising."""
        try:
            return action()
        except BagWriteError:
            self.closed = True
            self._unlock()
            self._chunk.clear()
            try:
                self._finish_file()
                self._write_description(self._files)
            except (BagWriteError, ValueError):
                # no room for the summary either, or the file is closed already
                self._file.abandon()
            raise

    def _check_open(self) -> None:
        if self.closed:
            raise BagWriteError(f"the bag {self.folder} is closed")


def _bytes_of(files: Iterable[FileRecord]) -> int:
    return sum(file.size for file in files)


def _link(path: Path, target: Path) -> None:
    """Give a file a second place, or, on a file system without links, only the new one."""
    try:
        target.hardlink_to(path)
    except OSError:
        path.rename(target)
