"""Files are written through `write_file`, runs through `new_run`: whole or not at all, and never over a measurement.

The content decides what a file is, on the disk and before writing: a run of any program, or a document of legid.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from daq.errors import InputError, input_errors

RUN = "run"
"""What `kind_of` calls a measurement."""
PLAN_HEADER = "time_s,tau2_cmd_nm"
MOST_BYTES = 1 << 29
"""Of a file that is read whole: half a gigabyte."""
HEAD, TAIL = 1 << 16, 1 << 16
_RUN_MAGIC = (b"\x89MCAP0\r\n", b"MATLAB 5.0", b"\x89HDF\r\n\x1a\n", b"SQLite format 3\0", b"#ROSBAG")
_GZIP, _PARQUET = b"\x1f\x8b", b"PAR1"
_STUDY = b"summed_squared_error_rad2"
"""A column of the only Parquet file of ours that is no run."""
_MARKS = ((r'^\s*\{\s*"schema":\s*"(legid\.[\w-]+/\d+)"', r"\1"),
          (r"\A<!DOCTYPE html>[\s\S]*(Made by legid|content=\"legid )", "page"),
          (r"<!-- Written by legid from an identified model[\s\S]*<(mujoco|robot)\b", r"\1"),
          (r"<(mujoco|robot)\b[\s\S]*<!-- Written by legid from an identified model", r"\1"),
          (r'\A"""[^"]*Written by `legid export', "simulator"),
          (r"\Amodel,beta1,", "samples"), (r"<svg[^>]*><style>svg\{color:", "picture"),
          (r"\A# An emulated rig served by", "emulated rig"))
_force: ContextVar[bool] = ContextVar("force", default=False)


@contextmanager
def replacing_anything(force: bool = True) -> Iterator[None]:
    """Within it `write_file` replaces files of another kind too (a command's `--force`); a run never."""
    token = _force.set(force)
    try:
        yield
    finally:
        _force.reset(token)


def write_file(path: Path | str, data: bytes, changed: bool = False) -> None:
    """Write `data` to `path`, whole or not at all: to a temporary file, synced, then renamed.

    An existing run is never replaced. A rig file or a file of another kind is replaced only within
    `replacing_anything`, or with `changed`: then `data` is the edited content. Raises `InputError`.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            if path.is_dir():
                raise InputError(str(path), "is a folder", "give the name of a file")
            path.write_bytes(data)  # a pipe or a terminal holds nothing that could be lost
            return
        if not changed:
            if path.exists() and path.read_bytes() == data:
                return
            check_place(path, kind_of_bytes(data))
        _replace(Path(os.path.realpath(path)), data)
    except OSError as error:
        raise _refused(path, error) from None


@contextmanager
def new_run(path: Path | str) -> Iterator[BinaryIO]:
    """A file to write a run into that is copied from another: it comes to `path` whole, at the end, or not at all.

    Raises `InputError` where something is there already, or the disk refuses.
    """
    path = Path(path)
    part = _part_of(path)
    try:
        if os.path.lexists(path):
            raise FileExistsError
        try:
            with open(part, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            _put(part, path)
        finally:
            with suppress(OSError):
                part.unlink()
    except FileExistsError:
        raise InputError(str(path), "exists already", "give a new name: a run is never overwritten") from None
    except OSError as error:
        raise _refused(path, error) from None
    _sync_folder(path.parent)


def open_regular(path: Path | str) -> BufferedReader:
    """The file at `path`, open to read. Raises `InputError` for a pipe, a device or a folder, which may have no end;
    `OSError` where there is nothing, or nothing may be read."""
    _check_regular(path, os.stat(path).st_mode)  # before it is opened: opening a device can do something
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    file = os.fdopen(descriptor, "rb")
    try:
        _check_regular(path, os.fstat(descriptor).st_mode)  # of what is open now
    except InputError:
        file.close()
        raise
    return file


def _check_regular(path: Path | str, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise InputError(str(path), "is a directory" if stat.S_ISDIR(mode) else "is no regular file",
                         "give a file on a disk, no pipe and no device")


def read_bytes(path: Path | str, most: int = MOST_BYTES) -> bytes:
    """The whole content of the regular file at `path`. Raises `InputError` for more than `most` bytes, and like
    `open_regular`."""
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise InputError(str(path), f"holds more than {most / 1e6:g} MB", "give a smaller part of it")
        data = file.read(most + 1)
    if len(data) > most:
        raise InputError(str(path), f"holds more than {most / 1e6:g} MB", "give a smaller part of it")
    return data


def check_place(path: Path | str, kind: str) -> None:
    """Raises `InputError` where an output of `kind` may not go to `path`: onto a run, or unasked onto a file of
    another kind."""
    found = kind_of(path)
    if found is None:
        return
    if found == RUN:
        raise InputError(str(path), "exists already", "give a new name: a run is never overwritten")
    if not _force.get() and (found != kind or found in ("", "rig")):
        what = f"exists and is {_words(found)}" if found else "exists and was not written by legid"
        raise InputError(str(path), what, "give another name, or --force to replace it")


def kind_of(path: Path | str) -> str | None:
    """Kind of the file at `path`; None where it is absent or empty, "" where the kind is unknown."""
    path = Path(path)
    with input_errors(path, "give a place that can be written"), suppress(FileNotFoundError):
        if stat.S_ISREG(path.stat().st_mode):
            with path.open("rb") as file:
                head = file.read(HEAD)
                file.seek(max(os.fstat(file.fileno()).st_size - TAIL, 0))
                return _kind(head, file.read(TAIL)) if head else None
    return None


def kind_of_bytes(data: bytes) -> str:
    """The same of content that is still to be written."""
    return _kind(data[:HEAD], data[-TAIL:])


def _kind(head: bytes, tail: bytes) -> str:
    if head.startswith(_RUN_MAGIC):
        return RUN
    if head.startswith(_PARQUET):
        return "study" if _STUDY in tail else RUN
    if head.startswith(_GZIP):
        with suppress(zlib.error):
            head = zlib.decompressobj(wbits=31).decompress(head, HEAD)
    text = head.decode("utf-8-sig", "replace")
    for mark, kind in _MARKS:
        if found := re.search(mark, text + "\n" + tail.decode("utf-8", "replace")):
            return found.expand(kind)
    lines = text.splitlines()
    if lines and lines[0].strip() == PLAN_HEADER:
        return "plan"
    if _is_table(lines):
        return RUN
    return "rig" if re.search(r"^\s*\[mechanism\]", text, re.MULTILINE) else ""


def _is_table(lines: list[str]) -> bool:
    """A line of two names or more, and soon below it one of as many numbers: a measurement, whoever made it."""
    cells = [re.split(r"[,;\t]", line) for line in lines[:5]]
    return len(cells) > 1 and any(len(row) > 1 and all(map(_is_number, row)) for row in cells)


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r'\s*"?[+-]?(\d+[.,]?\d*|[.,]\d+|nan|inf)([eE][+-]?\d+)?"?\s*', cell, re.IGNORECASE))


def _words(kind: str) -> str:
    return {"page": "a report", "picture": "a picture", "emulated rig": "an emulated rig's file",
            "plan": "a torque plan", "rig": "a rig file", "mujoco": "an MJCF model", "robot": "a URDF model",
            "study": "a study's table"}.get(kind, f"a {kind}")


def _refused(path: Path, error: OSError) -> InputError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return InputError(str(path), error.strerror or str(error),
                      "free space there, or give another place" if full else "give a place that can be written")


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name[:200]}.{secrets.token_hex(4)}.part")


def _put(part: Path, path: Path) -> None:
    """`part` under the name `path`, over nothing that came there meanwhile. Raises `FileExistsError`, `OSError`."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links, as a memory card's
        if os.path.lexists(path):
            raise FileExistsError from None
        part.rename(path)


def _replace(path: Path, data: bytes) -> None:
    part = _part_of(path)
    try:
        before = path.stat() if path.exists() else None
        with open(part, "xb") as file:
            file.write(data)
            file.flush()
            if before is not None:
                os.fchmod(file.fileno(), stat.S_IMODE(before.st_mode))
                with suppress(PermissionError):  # somebody else's file stays readable to them by its mode
                    os.fchown(file.fileno(), before.st_uid, before.st_gid)
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """The name itself onto the disk; some file systems have no such thing."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
