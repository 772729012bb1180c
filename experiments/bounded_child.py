"""A function's answer from a child process with bounds of memory and time.

A file of a hundred bytes can declare an array of 20 GB, and readers written in C can crash. Neither may take the
memory of a computer that records, nor end legid.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, NoReturn

from daq import InputError

WAIT_RATIO = 4.0
"""By the clock a child may take so many times longer: on a busy computer, or waiting for a disk."""
ANSWER, REFUSED = b"answer:\n", b"refused\n"
"""How what a child sends begins: eight bytes, so that numbers behind them can be used where they are."""


class Bounds(NamedTuple):
    """Memory and time that reading one file may take."""

    where: str
    """The file, as messages name it."""
    kind: str
    """What it should be, with its article."""
    most_bytes: int
    """Of memory beyond what this process has."""
    most_s: float
    """Of a processor [s]."""


def answer_of_child(work: Callable[[], list[bytes]], bounds: Bounds) -> bytearray:
    """The bytes that `work` returns, run in a child process. Raises `InputError`: that of `work`, and one where `work`
    raises anything else, goes beyond the bounds or crashes."""
    ours, theirs = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child starts none and waits for none
        child = os.fork()
    if child == 0:
        os.close(ours)
        _work_and_send(work, theirs, bounds)
    os.close(theirs)
    try:
        data = _received(ours, bounds)
    except BaseException:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    finally:
        os.close(ours)
    _, status = os.waitpid(child, 0)
    if not data or os.WIFSIGNALED(status):
        raise _killed(bounds, os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)
    return unpacked(data, bounds)


# -- in the child ------------------------------------------------------------------------------------------------------


def _work_and_send(work: Callable[[], list[bytes]], to: int, bounds: Bounds) -> NoReturn:
    """Never returns: nothing of the parent's is run by its child."""
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        _limit(bounds.most_bytes, bounds.most_s)
        os.dup2(os.open(os.devnull, os.O_RDWR), 0)
        os.dup2(0, 1)
        os.dup2(0, 2)  # libraries in C complain there, in more than a line
        with open(to, "wb") as pipe:
            for part in packed(work, bounds):
                pipe.write(part)
    except BaseException:  # the parent sees that nothing came, or not all
        os._exit(1)
    os._exit(0)


def packed(work: Callable[[], list[bytes]], bounds: Bounds) -> list[bytes]:
    """The answer of `work` for the pipe, or its refusal."""
    where, kind, most_bytes, _ = bounds
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return [ANSWER, *work()]
    except InputError as error:
        refused = error
    except MemoryError:
        refused = InputError(where, f"needs more than {most_bytes / 1e6:.0f} MB of memory to be read",
                             "give a smaller part of it")
    except RecursionError:
        refused = InputError(where, "is nested too deep", "give a table, or an array for each signal")
    except Exception as error:  # readers raise what their format makes of a damaged file
        refused = InputError(where, f"cannot be read as {kind} ({type(error).__name__}: {error})", "give a whole file")
    return [REFUSED, json.dumps((refused.where, refused.what, refused.remedy)).encode()]


def _limit(most_bytes: int, most_s: float) -> None:
    """Bounds of this process from now on: memory beyond what it has, time of a processor, no core."""
    with suppress(OSError, ValueError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _lower(resource.RLIMIT_AS, used + most_bytes)
    seconds = round(most_s)
    for kind, bound in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, most_bytes)):
        with suppress(OSError, ValueError):
            _lower(kind, bound)


def _lower(kind: int, bound: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))


# -- in the parent -----------------------------------------------------------------------------------------------------


def _received(ours: int, bounds: Bounds) -> bytearray:
    """Everything that the child sends until it ends."""
    where, most_bytes, deadline_s = bounds.where, bounds.most_bytes, time.monotonic() + WAIT_RATIO * bounds.most_s
    data = bytearray()
    while True:
        ready, _, _ = select.select([ours], [], [], max(deadline_s - time.monotonic(), 0.0))
        if not ready:
            raise InputError(where, "takes too long to be read", "give a smaller part of it, or close other programs")
        piece = os.read(ours, 1 << 20)
        if not piece:
            return data
        data += piece
        if len(data) > most_bytes:
            raise InputError(where, f"holds more than {most_bytes / 1e6:.0f} MB of numbers",
                             "give a smaller part of it")


def _killed(bounds: Bounds, number: int) -> InputError:
    where, most_s = bounds.where, bounds.most_s
    if number in (signal.SIGXCPU, signal.SIGKILL):
        return InputError(where, f"takes more than {most_s:.0f} s of a processor, or too much memory, to be read",
                          "give a smaller part of it")
    how = f"its reader crashed with signal {number}" if number else "its reader ended without a word"
    return InputError(where, f"cannot be read: {how}", "give a whole file")


def unpacked(data: bytearray, bounds: Bounds) -> bytearray:
    """The answer of `work`. Raises `InputError`: its refusal, or where it is cut short."""
    mark = bytes(data[:len(ANSWER)])
    del data[:len(ANSWER)]
    if mark == ANSWER:
        return data
    try:
        if mark != REFUSED:
            raise ValueError
        where, what, remedy = json.loads(data)
    except ValueError:
        raise ended_early(bounds.where) from None
    raise InputError(where, what, remedy)


def ended_early(where: str) -> InputError:
    """For an answer that is cut short."""
    return InputError(where, "cannot be read: its reader ended early", "give a whole file")
