"""Damaged inputs for the fuzzer.

Flipping bytes of a file tests its first check: a zip archive, a checksum or a hash notices. The
makers here take a good file apart, damage one layer of it and put it together again with lengths,
checksums and hash that are right, so that the layers behind are reached.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import random
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

TELLING: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2, 3, 65, 2**31, 2**63, 10**30, 10**400, 0.5, -0.0, 1e308, 5e-324),
    *(math.nan, math.inf, "", "x", "x" * 3000, "\ud800", "\x1b[31m\r\n", "3", [], {}, [[]], ["a"]),
)
_NUMBERS = (0, 1, 2, 7, 8, 9, 255, 65535, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
_BOMB = 300 << 20  # [B] of zeros in a few kB
_ZSTD = zstandard.ZstdCompressor(level=1).compress
Records = list[tuple[int, bytes]]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Return the data with some bytes changed, cut, doubled or replaced by telling values."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(changed)) if changed else 0
        kind = rng.randrange(6)
        if kind == 0 and changed:
            changed[place] = rng.randrange(256)
        elif kind == 1 and changed:
            changed[place] ^= 1 << rng.randrange(8)
        elif kind == 2:
            del changed[place : place + rng.randint(1, 64)]
        elif kind == 3:
            changed[place:place] = rng.randbytes(rng.randint(1, 16))
        elif kind == 4:
            changed[place : place + 8] = rng.choice((b"\xff" * 8, bytes(8), b"\x7f" + b"\xff" * 7))
        else:
            changed[place:place] = changed[place : place + rng.randint(1, 64)]
    return bytes(changed[: rng.randrange(len(changed) + 1)] if rng.random() < 0.1 else changed)


def text(rng: random.Random, seeds: tuple[str, ...]) -> str:
    """Return a text near one of the seeds, or arbitrary."""
    if rng.random() < 0.2:
        return rng.randbytes(rng.randrange(40)).decode("latin-1")
    letters = "ab0_9[].,:/ =\n\x00é-~'\"\\%$;()"
    word = list(rng.choice(seeds))
    for _ in range(rng.randint(0, 4)):
        place = rng.randrange(len(word) + 1)
        word[place : place + rng.randrange(3)] = [rng.choice(letters)] * rng.choice((1, 1, 1, 200))
    return "".join(word)


def tree(value: Any, rng: random.Random) -> Any:
    """Return a JSON value in which one place, at any depth, holds something else or nothing."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.15:
        return rng.choice(TELLING)
    changed = value.copy()
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key = rng.choice(keys)
    if rng.random() < 0.1:
        del changed[key]
    else:
        changed[key] = tree(value[key], rng)
    return changed


class ModelMaker:
    """Makes damaged model files.

    Parameters
    ----------
    good : bytes
        A model file.
    """

    def __init__(self, good: bytes) -> None:
        self._good = good
        with np.load(io.BytesIO(good)) as archive:
            self._arrays = {name: archive[name] for name in archive.files}
        self._meta = json.loads(self._arrays.pop("meta").tobytes())
        del self._arrays["sha256"]
        self._bomb = _zip({"K.npy": bytes(_BOMB)}, zipfile.ZIP_DEFLATED)

    def __call__(self, rng: random.Random) -> bytes:
        """Return the bytes of one."""
        if rng.random() < 0.1:
            return mutate(self._good, rng) if rng.random() < 0.99 else self._bomb
        layer = rng.choice(("meta", "meta", "text", "array", "array", "entry", "archive", "none"))
        arrays, described = dict(self._arrays), json.dumps(self._meta)
        if layer == "meta":
            described = json.dumps(tree(self._meta, rng))
        elif layer == "text":
            described = mutate(described.encode(), rng).decode("utf-8", "surrogateescape")
        elif layer == "array":
            name = rng.choice(list(arrays))
            arrays[name] = _array(arrays[name], rng)
        raw = described.encode("utf-8", "surrogateescape")
        if layer == "none" or rng.random() < 0.05:
            raw = json.dumps(self._other_model(arrays, rng)).encode()
        digest = hashlib.sha256(raw)
        for name, array in arrays.items():
            digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
        texts = {"meta": raw, "sha256": digest.hexdigest().encode()}
        entries = {name: np.frombuffer(word, np.uint8) for name, word in texts.items()} | arrays
        files = {f"{name}.npy": _npy(array) for name, array in entries.items()}
        if layer == "entry":
            name = rng.choice(list(files))
            files[name] = mutate(files[name], rng) if rng.random() < 0.7 else _header(rng)
        packed = _zip(files, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
        return _archive(files, packed, rng) if layer == "archive" else packed

    def _other_model(self, arrays: dict[str, NDArray[Any]], rng: random.Random) -> Any:
        """Fill in arrays of other sizes that fit together; return their description."""
        n, degree = rng.choice(((1, 1), (1, 9), (2, 3), (3, 2), (5, 1), (64, 1)))
        p = math.comb(n + degree, n)
        kept = np.array([rng.random() < 0.5 for _ in range(p)])
        modes = int(kept.sum())
        sizes = {"K": (p, p), "V_dom": (p, modes), "projector": (modes, p), "kept": (p,)}
        scale = rng.choice((0.0, 1.0, 1e300, -1e-300))
        for name, array in self._arrays.items():
            arrays[name] = np.full(sizes.get(name, (p,)), scale).astype(array.dtype)
        arrays["kept"] = kept
        observables = {"kind": "monomials", "n": n, "degree": degree}
        return {**self._meta, "observables": observables, "state_names": list("x" * n)}


def _array(array: NDArray[Any], rng: random.Random) -> NDArray[Any]:
    kind = rng.randrange(7)
    if kind == 0:
        number = array.real if array.dtype.kind == "c" else array
        return number.astype(rng.choice((">f8", "f4", "c8", "i8", "?", "U3", "S1", "V8", "M8[s]")))
    if kind == 1:
        return array.reshape(rng.choice(((-1,), (1, -1), (-1, 1), (-1, 2))))
    if kind == 2:
        return array[: rng.randrange(array.shape[0])]
    if kind == 3:
        return np.asfortranarray(array)
    if kind == 4:
        return np.full(rng.choice(((), (0,), (10,), (10, 10), (10, 0))), 1, array.dtype)
    if kind == 5:
        return np.array([None, {"a": [1]}], object)
    changed = array.copy()
    changed.flat[rng.randrange(array.size)] = rng.choice((math.nan, math.inf, 1e308, 0.0, -1.0))
    return changed


def _npy(array: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _header(rng: random.Random) -> bytes:
    """Return an array file that claims telling things of itself."""
    kind = rng.choice(("<f8", "|O", "<f8,(1000,1000,1000)", "<U99999999", "x", "|V0", "<c16"))
    shape = rng.choice(("(10, 10)", "()", "(-1,)", "(99999999999,)", "(0, 99999999999)", "((",
                        "(2.5,)", "(True,)", "10", "(" * 300, "(1,) * 9", "(10," * 40))  # fmt: skip
    order = rng.choice(("False", "True", "None", "1"))
    words = f"{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    version = rng.choice((1, 1, 1, 2, 3, 9))
    length = rng.choice((len(words), len(words), len(words), 0, 65535))
    size = struct.pack("<H" if version == 1 else "<I", length)
    return b"\x93NUMPY" + bytes((version, 0)) + size + words + bytes(800)


def _zip(files: dict[str, bytes], method: int) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return packed.getvalue()


def _archive(files: dict[str, bytes], packed: bytes, rng: random.Random) -> bytes:
    kind = rng.randrange(4)
    if kind < 2:  # its directory says telling things: sizes, offsets, method, flags, names
        changed = bytearray(packed)
        start = packed.index(b"PK\x01\x02")
        if kind == 0:
            place = rng.randrange(start, len(packed))
            changed[place] = rng.choice((0, 1, 8, 12, 14, 99, 127, 255))
        else:
            entry = packed.index(b"PK\x01\x02", rng.randrange(start, len(packed) - 200))
            changed[entry + 24 : entry + 28] = struct.pack("<I", rng.choice((0, 1, 10**6, 10**9)))
        return bytes(changed)
    chosen = rng.sample(sorted(files), rng.randrange(len(files) + 1))
    if kind == 2:
        return _zip({name: files[name] for name in chosen}, zipfile.ZIP_STORED)
    names = ("../K.npy", "K", "K.npy/", "\x00", "x" * 3000, "meta.npy.npy", "__class__.npy")
    extra = {rng.choice(names): rng.choice((b"", b"\x93NUMPY", files["K.npy"], b"PK"))}
    return _zip(files | extra, zipfile.ZIP_STORED)


class BagMaker:
    """Makes damaged recordings.

    Parameters
    ----------
    good : bytes
        A recording, for damage to its bytes.
    topics : dict of str to (type, definition, message)
        By topic: type name, definition text, and a serialized message.
    """

    def __init__(self, good: bytes, topics: dict[str, tuple[str, str, bytes]]) -> None:
        self._good = good
        self._topics = topics
        self._bombs = {"zstd": _ZSTD(bytes(_BOMB)), "lz4": lz4.frame.compress(bytes(_BOMB))}

    def __call__(self, rng: random.Random) -> bytes:
        """Return the bytes of one."""
        if rng.random() < 0.1:
            return mutate(self._good, rng)
        layer = rng.choice(
            ("message", "message", "definition", "types", "channel", "record", "order", "chunk",
             "compressed", "summary", "summary", "note", "none")
        )  # fmt: skip
        records = self._records(layer, rng)
        if layer == "order":
            _reorder(records, rng)
        if layer == "record":
            place = rng.randrange(len(records))
            records[place] = _damaged(records[place], rng)
        out = bytearray(MCAP0_MAGIC + _bytes(Header("ros2", "")))
        parts = rng.choice((1, 2, 3))
        for part in range(parts):
            inner = records[len(records) * part // parts : len(records) * (part + 1) // parts]
            out += self._stored(inner, layer, rng)
        note = len(out)
        words = "custom_data:\n  parameters: 'a: {ros__parameters: {b: 1}}'\n  git_revision: c\n"
        if layer == "note":
            words = mutate(words.encode(), rng).decode("utf-8", "replace")
        out += _bytes(Metadata("rosbag2", {"serialized_metadata": words}))
        length = len(out) - note
        out += struct.pack("<BQI", Opcode.DATA_END, 4, 0)
        if rng.random() < 0.3 and layer != "summary":
            return bytes(out)  # its recorder was killed
        summary = [item for item in records if item[0] in (Opcode.SCHEMA, Opcode.CHANNEL)]
        summary.append(_record(MetadataIndex(note, length, "rosbag2")))
        summary.append(_statistics(records))
        if layer == "summary":
            _reorder(summary, rng)
            for _ in range(rng.randrange(3)):
                place = rng.randrange(len(summary))
                summary[place] = _damaged(summary[place], rng)
        start = len(out)
        if layer == "summary" and rng.random() < 0.2:
            start = rng.choice((*_NUMBERS, rng.randrange(len(out))))
        return bytes(out) + _joined(summary) + _bytes(Footer(start, 0, 0)) + MCAP0_MAGIC

    def _records(self, layer: str, rng: random.Random) -> Records:
        """Return schemas, channels and messages, one of them damaged if the layer is theirs."""
        records: Records = []
        damaged = rng.choice(list(self._topics))
        for number, (topic, (name, words, message)) in enumerate(self._topics.items(), 1):
            chosen = topic == damaged
            if chosen and layer == "definition":
                words = text(rng, (words,)) if rng.random() < 0.9 else ""
            if chosen and layer == "types":
                name, words = definition(rng)
            channel = Channel(number, topic, "cdr", {}, number)
            if chosen and layer == "channel":
                channel.topic = rng.choice(("/a", "", "\x1b[31m", "x" * 3000, *self._topics))
                channel.message_encoding = rng.choice(("cdr", "json", "", "\n"))
                channel.schema_id = rng.choice((number, 0, 9))
                channel.metadata = {"offered_qos_profiles": text(rng, ("- {depth: 1}", "1", "[]"))}
            records.append(
                _record(Schema(number, words.encode("utf-8", "replace"), "ros2msg", name))
            )
            records.append(_record(channel))
            for step in range(rng.choice((0, 1, 3))):
                data = message
                if chosen and (layer == "message" or layer == "types"):
                    data = mutate(message, rng) if rng.random() < 0.5 else message[:4] + _words(rng)
                records.append(_record(Message(number, step * 1000, data, step * 1000, step)))
        return records

    def _stored(self, inner: Records, layer: str, rng: random.Random) -> bytes:
        """Return the records as a chunk, or as they are."""
        kind = rng.choice(("zstd", "zstd", "lz4", "", "loose"))
        raw = _joined(inner)
        if kind == "loose":
            return raw
        data = {"zstd": _ZSTD, "lz4": lz4.frame.compress, "": bytes}[kind](raw)
        chunk = Chunk(kind, data, 10**6, 0, zlib.crc32(raw), len(raw))
        if layer == "compressed" and rng.random() < 0.003 and kind:
            chunk.data, chunk.uncompressed_crc = self._bombs[kind], 0
            chunk.uncompressed_size = rng.choice((_BOMB, len(raw)))
        elif layer == "compressed":
            chunk.data = mutate(data, rng) if rng.random() < 0.7 else rng.randbytes(60)
            chunk.uncompressed_crc *= rng.randrange(2)
        elif layer == "chunk":
            chunk.compression = rng.choice((kind, kind, "lz4", "zstd", "", "gzip", "\x1b\n"))
            chunk.uncompressed_size = rng.choice((len(raw), *_NUMBERS))
            chunk.uncompressed_crc = rng.choice((chunk.uncompressed_crc, 0, 1))
            chunk.message_start_time = rng.choice(_NUMBERS)
            chunk.message_end_time = rng.choice(_NUMBERS)
        return _bytes(chunk)


def definition(rng: random.Random) -> tuple[str, str]:
    """Return the name of a message type and its definition: of types that hold one another."""
    names = [f"p/T{k}" for k in range(rng.choice((1, 2, 4, 30)))]
    kinds = ("float64", "uint8", "bool", "string", "wstring", "string<=5", "char", "int64",
             "builtin_interfaces/Time", "Header", *names, *names)  # fmt: skip
    ends = ("", "", "", "[]", "[3]", "[0]", "[<=2]", "[4000000000]", "[99999999999999999999]")
    parts = []
    for k, name in enumerate(names):
        lines = []
        for field in range(rng.choice((0, 1, 2, 2))):
            kind = rng.choice(kinds)
            if kind in names and rng.random() < 0.9:  # no circle: a deep tree
                kind = names[min(k + 1, len(names) - 1)] if k + 1 < len(names) else "uint8"
            lines.append(f"{kind}{rng.choice(ends)} f{field}")
        parts.append((f"MSG: {name}\n" if k else "") + "\n".join(lines) + "\n")
    return names[0].replace("/", "/msg/"), f"{'=' * 80}\n".join(parts)


def _words(rng: random.Random) -> bytes:
    """Return what a serialized message is made of: lengths, numbers, letters."""
    lengths = (0, 0, 1, 2, 3, 8, 100, 2**31, 2**32 - 1)
    return struct.pack("<16I", *(rng.choice(lengths) for _ in range(16)))[: rng.randrange(65)]


def _reorder(records: Records, rng: random.Random) -> None:
    """Drop, double or move some records."""
    for _ in range(rng.randint(1, 3)):
        if records:
            kind, taken = rng.randrange(3), records.pop(rng.randrange(len(records)))
            for _ in range(kind):
                records.insert(rng.randrange(len(records) + 1), taken)


def _damaged(record: tuple[int, bytes], rng: random.Random) -> tuple[int, bytes]:
    """Return the record with another content; its length is right."""
    opcode, content = record
    kind = rng.randrange(4)
    if kind == 0:
        return rng.choice((*range(16), 128, 255)), content
    if kind == 1:
        return opcode, mutate(content, rng)
    if kind == 2:
        return opcode, content[: rng.randrange(len(content) + 1)]
    size = rng.choice("HIQ")
    width = struct.calcsize(size)
    place = rng.randrange(0, max(1, min(len(content), 40)), 2)
    number = struct.pack(f"<{size}", rng.choice(_NUMBERS) % (1 << 8 * width))
    return opcode, content[:place] + number + content[place + width :]


def _statistics(records: Records) -> tuple[int, bytes]:
    counts: dict[int, int] = {}
    for opcode, content in records:
        if opcode == Opcode.MESSAGE and len(content) >= 2:
            number = int.from_bytes(content[:2], "little")
            counts[number] = counts.get(number, 0) + 1
    return _record(
        Statistics(
            attachment_count=0,
            channel_count=len(counts),
            channel_message_counts=counts,
            chunk_count=1,
            message_count=sum(counts.values()),
            message_end_time=2000,
            message_start_time=0,
            metadata_count=1,
            schema_count=len(counts),
        )
    )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _record(record: McapRecord) -> tuple[int, bytes]:
    raw = _bytes(record)
    return raw[0], raw[9:]


def _joined(records: Records) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(data)) + data for opcode, data in records)


def cdr(*parts: tuple[str, Any]) -> bytes:
    """Return a message in little-endian CDR; a part is a `struct` format, or ``s`` for a string."""
    out = bytearray()
    pack: Callable[..., bytes] = struct.pack
    for kind, value in parts:
        if kind == "s":
            word = value.encode() + b"\0"
            out += bytes(-len(out) % 4) + pack("<I", len(word)) + word
        else:
            out += bytes(-len(out) % struct.calcsize(kind)) + pack(f"<{kind}", value)
    return b"\0\1\0\0" + bytes(out)
