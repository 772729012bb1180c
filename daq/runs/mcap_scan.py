"""The whole records of an MCAP file that may end at any byte.

The library's record classes parse; the loop over records is our own, because the library's takes a short read
for data and spends nine tenths of its time on message indices that a sequential reader has no use for.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from daq.errors import InputError

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_KINDS: dict[int, Any] = {int(Opcode.SCHEMA): Schema, int(Opcode.CHANNEL): Channel, int(Opcode.ATTACHMENT): Attachment,
                          int(Opcode.METADATA): Metadata}


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

    def __iter__(self) -> Iterator[McapRecord]:
        try:
            with open(self.path, "rb") as file:
                size = os.fstat(file.fileno()).st_size
                if size == 0:
                    raise InputError(str(self.path), "is empty", "nothing was recorded; record again")
                if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                    raise InputError(str(self.path), "is not an MCAP file", "give a file written by legid record")
                yield from self._records(file, size)
        except OSError as error:
            raise InputError(str(self.path), error.strerror or str(error), "give a readable run file") from None

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
                else:
                    yield from _parsed(opcode, content)
            except (McapError, struct.error, UnicodeDecodeError):
                return  # bytes that are no record: what came before is whole

    def _chunk(self, content: bytes) -> list[McapRecord]:
        try:
            stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(content))), validate_crc=True)
            data = stream.read(length)
        except (CRCValidationError, RuntimeError):  # RuntimeError: lz4's own, in files of other writers
            self.damaged_chunks += 1
            return []
        records: list[McapRecord] = []
        at = 0
        while at < len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size
            records += _parsed(opcode, data[at: at + length])
            at += length
        return records


def _parsed(opcode: int, content: bytes) -> tuple[McapRecord, ...]:
    """The record, or nothing when it is of a kind that a reader of messages does not need."""
    if opcode == Opcode.MESSAGE:
        channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
        return (Message(channel_id, log_time, content[_MESSAGE.size:], publish_time, sequence),)
    kind = _KINDS.get(opcode)
    return () if kind is None else (kind.read(ReadDataStream(BytesIO(content))),)

