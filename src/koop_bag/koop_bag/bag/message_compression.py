"""Messages that were compressed one by one (rosbag2's compression mode `message`).

Each is a zstd frame that states its size. Its first bytes distinguish it from any serialized
message: CDR begins with a zero byte. So such messages are read without the bag's description.
"""

from collections.abc import Iterator
from pathlib import Path

import zstandard
from mcap.opcode import Opcode

from koop_bag.bag.metadata import Description
from koop_bag.errors import BagError
from koop_bag.mcap.file_reader import MAX_CHUNK, MESSAGE_HEAD, RECORD_HEAD, inner_places
from koop_bag.mcap.zstd_file import ZSTD_MAGIC

FORMAT = "zstd"
"""The method that rosbag2 contains."""

_BLOCK = 1 << 20  # [B] of records that are handed on together


def check_format(description: Description, path: Path) -> None:
    """Raise a BagError if the messages of a bag are compressed by another method."""
    if (
        description.compression_mode.upper() == "MESSAGE"
        and description.compression_format != FORMAT
    ):
        raise BagError(
            f"the messages of {path} are compressed as '{description.compression_format}'; "
            f"known is {FORMAT}"
        )


class MessageUnpacker:
    """Unpacks the messages of one file that are packed.

    Parameters
    ----------
    path : path
        The file, for errors.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._zstd = zstandard.ZstdDecompressor()

    def records(self, records: bytes) -> Iterator[bytes]:
        """MCAP records, with their messages unpacked, in pieces of bounded size."""
        if not _packed(records):
            yield records
            return
        out, head = bytearray(), MESSAGE_HEAD.size
        for opcode, at, length in inner_places(records):
            content = records[at : at + length]
            if opcode == Opcode.MESSAGE:
                content = content[:head] + self.message(content[head:])
            out += RECORD_HEAD.pack(opcode, len(content)) + content
            if len(out) >= _BLOCK:
                yield bytes(out)
                out.clear()
        yield bytes(out)

    def message(self, data: bytes) -> bytes:
        """One message, unpacked if it is packed."""
        if not data.startswith(ZSTD_MAGIC):
            return data
        try:
            size = zstandard.get_frame_parameters(data).content_size
            if size > MAX_CHUNK:  # unknown is the largest of all
                raise ValueError("no size, or one that no message has")
            return self._zstd.decompress(data)
        except (zstandard.ZstdError, ValueError, MemoryError) as error:
            raise BagError(
                f"{self._path} is damaged: a message does not decompress; "
                "`koop bag recover` saves the rest"
            ) from error


def _packed(records: bytes) -> bool:
    """Whether the first message is packed: all are, or none is."""
    for opcode, at, length in inner_places(records):
        if opcode == Opcode.MESSAGE and length > MESSAGE_HEAD.size:
            return records.startswith(ZSTD_MAGIC, at + MESSAGE_HEAD.size)
    return False
