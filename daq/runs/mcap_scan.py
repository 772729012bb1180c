"""The whole records of an MCAP file that may end at any byte.

The library's record classes parse; the loop over records is our own, because the library's takes a short read
for data and spends nine tenths of its time on message indices that a sequential reader has no use for.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from daq.errors import InputError, input_errors
from daq.files import open_regular

WINDOW_BYTES = 1 << 27
MOST_HEADER_BYTES = 1 << 20
SUM = "crc32"
"""Entry of a metadata record with its check sum, which MCAP has for chunks and attachments alone."""
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_KINDS: dict[int, Any] = {int(Opcode.SCHEMA): Schema, int(Opcode.CHANNEL): Channel, int(Opcode.ATTACHMENT): Attachment,
                          int(Opcode.METADATA): Metadata}
UNPACKED_BYTES, UNPACKED_RATIO = 64 << 20, 20
"""A file's compressed chunks may unpack to so much, and so many times the file's own size more: readings of sensors
pack to a half or a tenth, and what packs to a thousandth is made to fill the memory."""


def sum_of(name: str, metadata: Mapping[str, str]) -> str:
    """CRC-32 of a metadata record's name and entries but for its own, as 8 hexadecimal digits."""
    entries = json.dumps([name, sorted((key, value) for key, value in metadata.items() if key != SUM)])
    return f"{zlib.crc32(entries.encode()):08x}"


def written_by(path: Path) -> str | None:
    """The library that the file's MCAP header names; None where it has none that is whole."""
    with suppress(OSError, InputError, struct.error, McapError, ValueError), open_regular(path) as file:
        if file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
            opcode, length = _RECORD.unpack(file.read(_RECORD.size))
            if opcode == Opcode.HEADER and length <= MOST_HEADER_BYTES:
                return Header.read(ReadDataStream(BytesIO(file.read(length)))).library
    return None


class Scan:
    """Iterates over schemas, channels, messages, attachments and metadata, chunks opened, in the file's order.

    Afterwards `complete` and `damaged_chunks` tell how whole the file was. Raises `InputError` when there is
    nothing of an MCAP file in it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.complete = False
        """The file ends with its footer."""
        self.damaged_chunks = 0
        """Chunks left out because their check sum was wrong."""
        self.damaged_files: list[str] = []
        """Names of attachments whose check sum is wrong."""
        self.written: int | None = None
        """Messages in the file by its own count; None where it has none, as in a file that was cut."""
        self._room = 0

    def __iter__(self) -> Iterator[McapRecord]:
        with input_errors(self.path, "give a readable run file"), open_regular(self.path) as file:
            size = os.fstat(file.fileno()).st_size
            self._room = UNPACKED_BYTES + UNPACKED_RATIO * size
            if size == 0:
                raise InputError(str(self.path), "is empty", "nothing was recorded; record again")
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise InputError(str(self.path), "is not an MCAP file", "give a file written by legid record")
            yield from self._records(file, size)

    def _records(self, file: BinaryIO, size: int) -> Iterator[McapRecord]:
        while len(head := file.read(_RECORD.size)) == _RECORD.size:
            opcode, length = _RECORD.unpack(head)
            if length > size - file.tell():
                return  # cut off in the middle of this record
            content = file.read(length)
            try:
                if opcode == Opcode.CHUNK:
                    yield from self._chunk(content)
                elif opcode == Opcode.FOOTER:
                    self.complete = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
                    return
                elif opcode == Opcode.STATISTICS:
                    self.written = Statistics.read(ReadDataStream(BytesIO(content))).message_count
                else:
                    for record in _parsed(opcode, content):
                        if isinstance(record, Attachment) and not _is_sound(content):
                            self.damaged_files.append(record.name)
                        if isinstance(record, Metadata) and \
                                record.metadata.get(SUM, "") not in ("", sum_of(record.name, record.metadata)):
                            self.damaged_files.append(f"the metadata {record.name!r}")
                        yield record
            except (McapError, struct.error, ValueError, OverflowError):
                return  # bytes that are no record: what came before is whole

    def _chunk(self, content: bytes) -> Iterator[McapRecord]:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        data = self._unpacked(chunk)
        if data is None or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
            self.damaged_chunks += 1
            return
        at = 0
        while at < len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            yield from _parsed(opcode, data[at: at + length])
            at += length

    def _unpacked(self, chunk: Chunk) -> bytes | None:
        """The chunk's records; None where it does not unpack. Raises `InputError` for more than a run could hold."""
        if not chunk.compression:
            return chunk.data
        size = chunk.uncompressed_size
        self._room -= size
        if self._room < 0:
            raise InputError(str(self.path), f"unpacks to more than {UNPACKED_RATIO} times its size",
                             "no record of sensors does; give a run file")
        try:
            data = _unpack(chunk.compression, chunk.data, size + 1)
        except (zstandard.ZstdError, RuntimeError, EOFError):  # RuntimeError: lz4's own
            return None
        return data if len(data) == size else None


def _unpack(compression: str, data: bytes, most: int) -> bytes:
    """At most `most` bytes of it, whatever the packed data says of its own size."""
    if compression == "zstd":
        return bytes(zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(data).read(most))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))
    raise RuntimeError(f"compression {compression!r} is not known")


def _is_sound(attachment: bytes) -> bool:
    (crc,) = struct.unpack("<I", attachment[-4:])
    return crc in (0, zlib.crc32(attachment[:-4]))


def _parsed(opcode: int, content: bytes) -> tuple[McapRecord, ...]:
    """The record, or nothing when it is of a kind that a reader of messages does not need."""
    if opcode == Opcode.MESSAGE:
        channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
        return (Message(channel_id, log_time, content[_MESSAGE.size:], publish_time, sequence),)
    kind = _KINDS.get(opcode)
    return () if kind is None else (kind.read(ReadDataStream(BytesIO(content))),)

