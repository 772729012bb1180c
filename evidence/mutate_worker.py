"""Many broken files through a reader in one process, which ends when a file crashes it or takes too much.

A reader of `exchange` runs in a child for every file. Here a child reads thousands, with the same code in it: a file at
which it dies is read again by the command's own way, which must refuse it in one line.
"""

import json
import mmap
import os
import resource
import select
import signal
import struct
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from daq import InputError
from experiments import bounded_child
from experiments.exchange import bounded
from experiments.simulators import robot

SECONDS, BYTES = 10.0, 1 << 30
"""Most of a processor's time and of memory that a file may take, the second beyond what the study has."""
STOPPED_S = bounded.BASE_S
"""The reader of a small file of others is stopped after so much of a processor's time."""
STANDSTILL_S = 120.0
"""By the clock, on a computer that does much else: who waits for ever uses no processor."""
AGAIN_EVERY = 500
"""One file of so many is read by the command's own way, too, and must end alike."""
STATE = struct.Struct("<qqqd")
"""Number of the file, how many were read and refused, longest time [s]."""
Read = Callable[[Path], object]
Put = Callable[[int, Path], None]
BOUNDED: tuple[Any, ...] = (bounded, robot)
"""Modules that read in a child."""


class Fault(NamedTuple):
    """What came of a file that was neither read nor refused."""

    format: str
    number: int
    what: str


class Kind(NamedTuple):
    """Files of one format."""

    name: str
    path: Path
    put: Put
    """Writes the file of a number."""
    read: Read


def here(work: Callable[[], list[bytes]], bounds: bounded_child.Bounds) -> bytearray:
    """In this process what a child of it would read."""
    return bounded_child.unpacked(bytearray(b"".join(bounded_child.packed(work, bounds))), bounds)


def read_by(answer: Callable[..., bytearray]) -> None:
    """From now on."""
    for module in BOUNDED:
        module.answer_of_child = answer


def outcome(kind: Kind) -> tuple[str, str]:
    """`read` or `refused`, and the fault in words, empty for none."""
    try:
        kind.read(kind.path)
        return "read", ""
    except InputError as error:
        text = str(error)
        long = "\n" in text or len(text) > 2000
        return "refused", f"says {len(text)} characters: {text[:200]!r}" if long else ""
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return "refused", (f"{type(error).__name__}: {str(error)[:200]} ({Path(where.filename).name}, "
                           f"line {where.lineno})")


def study(kind: Kind, first: int, files: int) -> tuple[Counter[str], list[Fault]]:
    """How many were read, refused and stopped by their bounds, and what became of the others."""
    counts, faults, longest, number = Counter[str](), list[Fault](), 0.0, first
    while number < first + files:
        state = mmap.mmap(-1, STATE.size)
        state[:] = STATE.pack(number, 0, 0, 0.0)
        told = _worker(kind, number, first + files, state)
        number, read, refused, worst = STATE.unpack(state[:])
        counts.update(read=read, refused=refused)
        longest = max(longest, worst)
        faults += [Fault(kind.name, *one) for one in told]
        if number < first + files:  # it died at this one
            kind.put(number, kind.path)
            began = used_s()
            what, fault = in_child(kind)
            longest, number = max(longest, used_s() - began), number + 1
            counts.update(stopped=1)
            if what != "refused" or fault:
                faults.append(Fault(kind.name, number - 1, f"ends a reader, and then: {what} {fault}"))
    counts["worst_ms"] = round(1e3 * longest)
    return counts, faults


def used_s() -> float:
    """Time of a processor that this process and its children have used [s]."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _worker(kind: Kind, first: int, last: int, state: mmap.mmap) -> list[tuple[int, str]]:
    """Faults of the files from `first` until a child has read all, or died."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(ours)
            _read_all(kind, first, last, state, theirs)
        finally:
            os._exit(1)
    os.close(theirs)
    data, seen, since = b"", -1, time.monotonic()
    while True:
        ready, _, _ = select.select([ours], [], [], 1.0)
        if ready:
            piece = os.read(ours, 1 << 16)
            if not piece:
                break
            data += piece
        now = STATE.unpack(state[:])[0]
        seen, since = (seen, since) if now == seen else (now, time.monotonic())
        if time.monotonic() - since > STANDSTILL_S:
            os.kill(child, signal.SIGKILL)
    os.close(ours)
    os.waitpid(child, 0)
    return [(int(number), str(what)) for number, what in map(json.loads, data.splitlines())]


def _read_all(kind: Kind, first: int, last: int, state: mmap.mmap, to: int) -> None:
    """In the child: every file, its outcome in `state`, its fault into the pipe."""
    warnings.simplefilter("error")
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends it
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(null, stream)
    read_by(here)
    counts, worst = Counter[str](), 0.0
    _limit_memory()
    for number in range(first, last):
        state[:] = STATE.pack(number, counts["read"], counts["refused"], worst)
        kind.put(number, kind.path)
        began = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, STOPPED_S)
        what, fault = outcome(kind)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        worst = max(worst, time.process_time() - began)
        if number % AGAIN_EVERY == 0:
            read_by(bounded_child.answer_of_child)
            other, _ = outcome(kind)
            read_by(here)
            fault = fault or f"{what} here, {other} by the command's own way" * (other != what)
        counts[what] += 1
        if fault:
            os.write(to, json.dumps((number, fault)).encode() + b"\n")
    state[:] = STATE.pack(last, counts["read"], counts["refused"], worst)


def in_child(kind: Kind) -> tuple[str, str]:
    """`outcome` by the command's own way in a process of its own, with the bounds of the target."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (round(SECONDS), round(SECONDS) + 1))
            _limit_memory()
            os.write(theirs, json.dumps(outcome(kind)).encode())
        finally:
            os._exit(0)
    os.close(theirs)
    with open(ours, "rb") as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    what, fault = json.loads(text) if text else ("crashed", "its reader took the study's own process with it")
    return what, fault


def _limit_memory() -> None:
    with suppress(OSError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
