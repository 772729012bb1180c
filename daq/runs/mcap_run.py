"""Run files: MCAP, written so that a crash loses next to nothing and read as far as they are whole."""

from __future__ import annotations

import os
import struct
import threading
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from daq.errors import InputError, WorkError, input_errors
from daq.files import new_run
from daq.findings import Damage
from daq.runs.damage import damage_of, holes
from daq.runs.mcap_scan import SUM, Scan, sum_of
from daq.runs.streams import CDR_HEADER, NOTE_SCHEMA, NOTE_TEXT, NOTE_TOPICS, STREAMS, Note, pack_note, read_notes

FLUSH_MESSAGES = 75
"""A tenth of a second of a leg at 500 Hz with its IMU: so long a disk that is full goes unnoticed."""
SYNC_EVERY_S = 1.0
WATCH_EVERY_S = 0.02
"""How often the file is looked at while it is written: a run that is not in its place any more is no measurement."""
CLOSE_S = 2.0
"""Longest wait for another thread's write that hangs, at the end."""
FACTS = "legid"
"""Name of the metadata record."""
RECOVERED = "legid.recovered"
"""Of the one with what was missing within a run before `recover` made a clean file of it."""
PROFILE = "ros2"
MOST_DIGITS = 19
"""Of nanoseconds since 1970, until the year 2286; a number of more is no time."""
_GONE = "is not in its place any more; leave the file alone while it is recorded"


class RunWriter:
    """Writes one run. Every 75 messages the chunk in progress is finished and handed to the system, so that
    a killed process loses at most those; once a second it is forced to the disk, so that a power cut loses
    at most that. May be used from several threads.

    `files` (rig.toml, plan.csv, ...) become attachments, `facts` (versions, start times) metadata.
    Raises `WorkError` when the disk refuses.
    """

    def __init__(self, path: Path | str, files: Mapping[str, str], facts: Mapping[str, str] | None = None) -> None:
        self.path = Path(path)
        self.messages = 0
        self.saved_ns = 0
        """Host time of the newest message that is on the disk [ns], all before it too; 0 before the first."""
        self.failed = ""
        """Why something could not be written; empty while all was."""
        self._newest_ns = 0
        self._handed_bytes = 0
        self._watch_due = 0.0
        self._lock = threading.Lock()
        self._unflushed = 0
        self._synced_at = time.monotonic()
        self._closed = False
        self._file = _create(self.path)
        try:
            self._begin(files, facts or {})
        except BaseException as error:
            with suppress(OSError):  # no file without a measurement, which would keep its name from the next try
                if not self._problem():
                    self.path.unlink()
            with suppress(OSError):
                self._file.close()
            if isinstance(error, OSError):
                raise self._refused(error) from None
            raise

    def _begin(self, files: Mapping[str, str], facts: Mapping[str, str]) -> None:
        """Everything that stands before the first message, onto the disk."""
        self._writer = new_writer(self._file)
        _add_metadata(self._writer, FACTS, {"format": "legid.run/1", "version": _version(), **facts})
        for name, text in files.items():
            self._writer.add_attachment(time.time_ns(), time.time_ns(), name, "text/plain", text.encode())
        self._channels: dict[str, int] = {}
        self._packers = {topic: stream.packer for topic, stream in STREAMS.items()}
        for topic, stream in STREAMS.items():
            self._register(topic, stream.schema, stream.text)
        note = self._writer.register_schema(NOTE_SCHEMA, "ros2msg", NOTE_TEXT.encode())
        for topic in NOTE_TOPICS:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", note)
        self._sync()

    def _register(self, topic: str, schema: str, text: str) -> None:
        number = self._writer.register_schema(schema, "ros2msg", text.encode())
        self._channels[topic] = self._writer.register_channel(topic, "cdr", number)

    def add(self, topic: str, host_ns: int, *values: float, sequence: int = 0) -> None:
        """One message: `values` in the order of the stream's fields."""
        self._add(topic, host_ns, self._packers[topic].pack(CDR_HEADER, *values), sequence)

    def event(self, host_ns: int, kind: str, text: str) -> None:
        """Something that happened, for a person; out of this process when this returns."""
        self._add("/events", host_ns, pack_note(Note(host_ns, kind, text)), 0, flush=True)

    def config(self, host_ns: int, kind: str, text: str) -> None:
        """A fact learned while recording (firmware's hello, scales), as JSON text."""
        self._add("/config", host_ns, pack_note(Note(host_ns, kind, text)), 0)

    def _add(self, topic: str, host_ns: int, data: bytes, sequence: int, flush: bool = False) -> None:
        with self._lock:
            if self._closed:
                return
            try:
                self._writer.add_message(self._channels[topic], host_ns, data, host_ns, sequence)
                self.messages += 1
                self._newest_ns = max(self._newest_ns, host_ns)
                self._unflushed += 1
                if flush or self._unflushed >= FLUSH_MESSAGES:
                    self._watch()  # before the file grows: it would hide that it was cut short
                    self._writer.flush()  # type: ignore[no-untyped-call]
                    self._unflushed = 0
                    self._handed_bytes = self._file.tell()
            except OSError as error:
                raise self._refused(error) from None
            now = time.monotonic()
            if now - self._synced_at >= SYNC_EVERY_S:
                self._sync()
            if now >= self._watch_due:
                self._watch_due = now + WATCH_EVERY_S
                self._watch()

    def _watch(self) -> None:
        """Raises `WorkError` when the file was removed, replaced or cut short by somebody else."""
        problem = self._problem()
        if problem:
            raise WorkError(problem)

    def _problem(self) -> str:
        """What has become of the file, in a line; empty while it is well."""
        ours = os.fstat(self._file.fileno())
        try:
            there = os.stat(self.path)
        except OSError as error:
            return f"{self.path}: {_GONE} ({error.strerror or error})"
        if (there.st_ino, there.st_dev) != (ours.st_ino, ours.st_dev):
            return f"{self.path}: {_GONE} (another file is in its place)"
        if ours.st_size < self._handed_bytes:
            return (f"{self.path}: was cut short to {ours.st_size} of {self._handed_bytes} bytes while it was "
                    "recorded; keep other programs away from it")
        return ""

    def _sync(self) -> None:
        self._watch()
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fdatasync(self._file.fileno())
        except OSError as error:
            raise self._refused(error) from None
        self._unflushed = 0
        self._handed_bytes = self._file.tell()
        self.saved_ns = self._newest_ns
        self._synced_at = time.monotonic()

    def _refused(self, error: OSError) -> WorkError:
        kept = ", then repair the file with legid recover" if self.messages else ""
        self.failed = f"{self.path}: cannot be written ({error.strerror or error}); free space on the disk{kept}"
        return WorkError(self.failed)

    def close(self) -> None:
        """Finish the file: index, footer, disk; then see that it is there, whole. May be called twice.

        Raises `WorkError` where the disk refuses, hangs in another thread, or holds something else.
        """
        if not self._lock.acquire(timeout=CLOSE_S):
            raise WorkError(f"{self.path}: the disk does not answer; the file is not finished")
        try:
            if self._closed:
                return
            self._closed = True
            problem = self._problem()
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fdatasync(self._file.fileno())
                self._handed_bytes = self._file.tell()
                problem = problem or self._problem()
            except OSError as error:
                raise self._refused(error) from None
            finally:
                with suppress(OSError):  # said already, or nothing left to lose: the data is on the disk
                    self._file.close()
            if problem:
                raise WorkError(problem)
            self._verify()
        finally:
            self._lock.release()

    def _verify(self) -> None:
        """Raises `WorkError` unless the file's own index counts all messages that were written."""
        try:
            with open(self.path, "rb") as file:
                summary = make_reader(file).get_summary()
            found = summary.statistics.message_count if summary and summary.statistics else None
        except (OSError, McapError, ValueError, struct.error):
            found = None
        if found != self.messages:
            raise WorkError(f"{self.path}: holds {'none' if found is None else found} of {self.messages} messages "
                            "after closing; check the disk, then look at the file with legid info")


@dataclass(frozen=True)
class RawRun:
    """Content of a run file, unconverted."""

    name: str
    facts: Mapping[str, str]
    """Metadata of the file: format, version, start times."""
    files: Mapping[str, str]
    """Attached texts by name: `rig.toml`, `plan.csv`."""
    streams: Mapping[str, NDArray[np.void]]
    """Topic to messages, a structured array with the fields of `daq.runs.streams`; every topic is there."""
    events: list[Note] = field(default_factory=list)
    config: list[Note] = field(default_factory=list)
    complete: bool = True
    """False when the file ends before its footer (a crash, a full disk)."""
    damaged_chunks: int = 0
    """Chunks whose check sum was wrong; their messages are left out."""
    damage: tuple[Damage, ...] = ()
    """Everything by which the file is not what was recorded; see `daq.runs.damage`."""

    @property
    def messages(self) -> int:
        return sum(map(len, self.streams.values())) + len(self.events) + len(self.config)


def read_run(path: Path | str) -> RawRun:
    """Everything that is whole in the file at `path`, cut at any byte though it may be.

    Raises `InputError` when there is nothing of an MCAP file in it.
    """
    path = Path(path)
    scan = Scan(path)
    topics: dict[int, str] = {}
    payloads: dict[str, list[bytes]] = defaultdict(list)
    facts: dict[str, str] = {}
    files: dict[str, str] = {}
    lost: list[str] = []
    wanted, seen = {*STREAMS, *NOTE_TOPICS}, 0
    for record in scan:
        if isinstance(record, Message):
            seen += 1
            topic = topics.get(record.channel_id, "")
            if topic in wanted:
                payloads[topic].append(record.data)
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Metadata) and record.name == FACTS:
            facts.update(_entries(record))
        elif isinstance(record, Metadata) and record.name == RECOVERED:
            lost += _entries(record).values()
        elif isinstance(record, Attachment):
            files[record.name] = record.data.decode("utf-8", "replace")
    streams = {topic: stream.unpack(payloads[topic]) for topic, stream in STREAMS.items()}
    events, config = (read_notes(payloads[topic]) for topic in NOTE_TOPICS)
    read = sum(stream.size for stream in streams.values()) + len(events) + len(config)
    damage = (*(Damage("recovered", f"before it was recovered: {text}") for text in lost),
              *damage_of(scan, seen, sum(map(len, payloads.values())) - read, streams["/imu"]))
    return RawRun(path.name, facts, files, streams, events, config, scan.complete, scan.damaged_chunks, damage)


def attached_texts(path: Path | str) -> dict[str, str]:
    """`RawRun.files` alone, of a file whose messages follow them, as ours do. Raises `InputError` like `read_run`."""
    files: dict[str, str] = {}
    for record in Scan(Path(path)):
        if isinstance(record, Message):
            break
        if isinstance(record, Attachment):
            files[record.name] = record.data.decode("utf-8", "replace")
    return files


def start_of(facts: Mapping[str, str]) -> datetime | None:
    """When a recording with these `facts` began [UTC]."""
    started = facts.get("started_unix_ns", "")
    known = started.isascii() and started.isdecimal() and len(started) <= MOST_DIGITS
    return datetime.fromtimestamp(int(started) / 1e9, UTC) if known else None


@dataclass(frozen=True)
class RecoverReport:
    """Report on what `recover` saved."""

    messages: int
    damaged_chunks: int
    complete: bool
    """True when the file was whole already."""


def recover(path: Path | str, out: Path | str) -> RecoverReport:
    """Write everything that is whole in `path` to a clean, indexed file `out`, which must not exist and comes whole.

    A run whose end was cut off is then whole, only shorter. What is missing within it stays known of the new file.
    Raises `InputError` when `path` is no MCAP file or `out` cannot be written.
    """
    scan = Scan(Path(path))
    records = iter(scan)
    first = next(records, None)  # refuses what is no MCAP file before anything is written
    messages = 0
    with new_run(out) as file:
        writer = new_writer(file)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for record in chain([first], records):
            if isinstance(record, Message) and record.channel_id in channels:
                writer.add_message(channels[record.channel_id], record.log_time, record.data,
                                   record.publish_time, record.sequence)
                messages += 1
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas.get(record.schema_id, 0), record.metadata)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        lost = holes(scan, messages)
        if lost:
            _add_metadata(writer, RECOVERED, {str(k): damage.text for k, damage in enumerate(lost)})
        writer.finish()  # type: ignore[no-untyped-call]
    return RecoverReport(messages, scan.damaged_chunks, scan.complete)


def _add_metadata(writer: Writer, name: str, entries: Mapping[str, str]) -> None:
    """A record of metadata with a check sum of its own."""
    writer.add_metadata(name, {**entries, SUM: sum_of(name, entries)})


def _entries(record: Metadata) -> dict[str, str]:
    return {key: value for key, value in record.metadata.items() if key != SUM}


def new_writer(file: BinaryIO) -> Writer:
    """A started writer. Chunks stay uncompressed: they are short, and a damaged one stays readable by hand."""
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start(PROFILE, f"legid {_version()}")
    return writer


def _create(path: Path) -> BinaryIO:
    with input_errors(path, "give a place that can be written"):
        try:
            return open(path, "xb")
        except FileExistsError:
            raise InputError(str(path), "exists already", "give a new name: a run is never overwritten") from None


def _version() -> str:
    try:
        return version("legid")
    except PackageNotFoundError:
        return "unknown"
