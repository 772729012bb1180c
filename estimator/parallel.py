"""`parallel_map`: independent pieces of one computation on several processes; `worker_pool`: such processes, none of
which outlives this one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

T = TypeVar("T")
SAFE_PATH = {"PYTHONSAFEPATH": "1"}
"""A new Python process with this imports nothing from the folder it is started in, which may be anybody's."""
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
    try:
        with worker_pool(workers, "fork") as pool:
            return list(pool.map(_call, range(count)))
    except BrokenProcessPool:
        return [work(i) for i in range(count)]
    finally:
        _work = None


@contextmanager
def worker_pool(workers: int, start: str | None = None, environment: Mapping[str, str] | None = None
                ) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with this one, however it ends, and leave the terminal's Ctrl-C to it.

    Left by an exception, Ctrl-C among them, what they are at is not waited for: they are killed. `start` is a start
    method of `multiprocessing`, the platform's by default. `environment` is added to theirs; they import nothing from
    the folder they are started in.
    """
    with _environment(SAFE_PATH | dict(environment or {})):
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context(start), _belong_to_parent)
        try:
            yield pool
        except BaseException:
            for process in list((getattr(pool, "_processes", None) or {}).values()):  # kill_workers, of Python 3.14
                process.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _environment(added: Mapping[str, str]) -> Iterator[None]:
    """Environment variables that new processes find when they start."""
    before = {name: os.environ.get(name) for name in added}
    os.environ.update(added)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _belong_to_parent() -> None:
    """Leave Ctrl-C, which the whole foreground hears, to the parent, and end when that is gone: after a SIGTERM or a
    SIGKILL nobody else tells a worker to, and one that waits for work would wait for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="parent", daemon=True).start()


def _call(i: int) -> Any:
    assert _work is not None
    return _work(i)
