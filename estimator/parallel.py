"""`parallel_map`: independent pieces of one computation on several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

T = TypeVar("T")
_work: Callable[[int], Any] | None = None
"""What a pool is for while it lasts: forked processes inherit it, for functions within functions cannot be sent."""


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parallel_map(work: Callable[[int], T], count: int, workers: int) -> list[T]:
    """[work(0), ..., work(count - 1)], on up to `workers` forked processes; in this one where they cannot be had.

    What `work` raises is raised. What it changes is lost: only what it returns comes back, and must be picklable. Where
    a process is killed, for want of memory perhaps, all is done again in this one.
    """
    global _work
    workers = min(workers, count)
    if workers < 2 or _work is not None or "fork" not in multiprocessing.get_all_start_methods():
        return [work(i) for i in range(count)]
    _work = work
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), _leave_interrupts)
    try:
        return list(pool.map(_call, range(count)))
    except BrokenProcessPool:
        return [work(i) for i in range(count)]
    finally:
        pool.shutdown(cancel_futures=True)
        _work = None


def _leave_interrupts() -> None:
    """Of the whole foreground: one process answers them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _call(i: int) -> Any:
    assert _work is not None
    return _work(i)
