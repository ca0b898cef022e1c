"""Bags as rosbag2 compresses them, made with the `mcap` and `zstandard` libraries.

The format is that of rosbag2 0.26 (`rosbag2_compression/sequential_compression_writer.cpp`,
`rosbag2_compression_zstd/zstd_compressor.cpp`): in mode MESSAGE every serialized message is a zstd
frame that tells its size, and the file stays an MCAP one; in mode FILE the whole file is one zstd
stream, `.zstd` is added to its name, and `relative_file_paths` says so. `compression_mode` and
`compression_format` stand in `metadata.yaml` and in the file's metadata record.
"""

from __future__ import annotations

from pathlib import Path

import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

METADATA = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"


def compress(source: Path, target: Path, mode: str, name: str = "zstd") -> Path:
    """Write a bag again, compressed in a mode; return its folder."""
    target.mkdir(parents=True)
    told = yaml.safe_load((source / METADATA).read_text())
    inner = told[ROOT]
    inner |= {"compression_format": name, "compression_mode": mode}
    for i, file in enumerate(inner["relative_file_paths"]):
        path = target / file
        _rewrite(source / file, path, inner, packed=mode == "MESSAGE")
        if mode == "FILE":
            packed = path.with_name(f"{path.name}.zstd")
            # as a stream: the size of the content is not told
            with path.open("rb") as plain, packed.open("wb") as stream:
                zstandard.ZstdCompressor().copy_stream(plain, stream)
            path.unlink()
            inner["relative_file_paths"][i] = packed.name
    (target / METADATA).write_text(yaml.safe_dump(told, sort_keys=False))
    return target


def _rewrite(source: Path, target: Path, inner: object, packed: bool) -> None:
    with source.open("rb") as old, target.open("wb") as new:
        reader = make_reader(old)
        # rosbag2's default: chunks without compression and without checksum
        writer = Writer(new, chunk_size=20_000, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2")
        writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(inner)})
        summary = reader.get_summary()
        assert summary is not None
        schemas = {
            item.id: writer.register_schema(item.name, item.encoding, item.data)
            for item in summary.schemas.values()
        }
        channels = {
            item.id: writer.register_channel(
                item.topic, item.message_encoding, schemas[item.schema_id], item.metadata
            )
            for item in summary.channels.values()
        }
        for _, channel, message in reader.iter_messages(log_time_order=False):
            data = zstandard.compress(message.data, 1) if packed else message.data
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
        writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(inner)})
        writer.finish()
