"""Threads whose failure is somebody's: the first exception in any of them is kept and raised where it is asked for."""

from __future__ import annotations

import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from daq.recording.intake import Sink

REAL_TIME_PRIORITY = 5


@contextmanager
def real_time() -> Iterator[bool]:
    """This thread, and those that it starts meanwhile, ahead of every ordinary process; yields whether it was granted.

    A FIFO that is drained late has lost samples. It takes a right that root has, or a line `@group - rtprio 5` in
    /etc/security/limits.conf; without it recording goes on as any program does.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REAL_TIME_PRIORITY))
    except (OSError, AttributeError):  # AttributeError: a system without these calls
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)


def hurry(thread: threading.Thread) -> None:
    """Give a thread that was started before `real_time` the same right; nothing happens where it is not granted."""
    if thread.native_id is None:
        return
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(thread.native_id, os.SCHED_RR, os.sched_param(REAL_TIME_PRIORITY))


@contextmanager
def noted_signals(note: Callable[[str], None]) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP are noted by name, however often they come; they belong to the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "SIGHUP"}
    before = {number: signal.signal(number, lambda number, _: note(names[signal.Signals(number)])) for number in names}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def in_time(work: Callable[[], None], seconds: float) -> bool:
    """Do `work` in a thread of its own; whether it ended in time. One that hangs is left behind. Raises its error."""
    failed: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, name="finish", daemon=True)
    thread.start()
    thread.join(seconds)
    if failed:
        raise failed[0]
    return not thread.is_alive()


class Workers:
    """Runs functions over and over, each in a thread of its own, until `stop` or the first failure."""

    def __init__(self) -> None:
        self.failure: BaseException | None = None
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self, name: str, turn: Callable[[], None], every_s: float = 0.0) -> None:
        """Call `turn` every `every_s` [s], or as fast as it comes back when that is 0."""
        thread = threading.Thread(target=self._run, args=(turn, every_s), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def check(self) -> None:
        """Raise what a thread failed with."""
        if self.failure is not None:
            raise self.failure

    def stop(self, timeout_s: float = 2.0) -> None:
        """End all threads and wait for them."""
        self._ending.set()
        for thread in self._threads:
            thread.join(timeout_s)

    def _run(self, turn: Callable[[], None], every_s: float) -> None:
        try:
            while not self._ending.wait(every_s) if every_s else not self._ending.is_set():
                turn()
        except BaseException as error:
            self.failure = self.failure or error
            self._ending.set()


class QueuedSink:
    """Hands messages to a thread that writes them, so that a slow disk never delays a device."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, topic: str, host_ns: int, *values: float, sequence: int = 0) -> None:
        self._queue.put(lambda: self._sink.add(topic, host_ns, *values, sequence=sequence))

    def event(self, host_ns: int, kind: str, text: str) -> None:
        self._queue.put(lambda: self._sink.event(host_ns, kind, text))

    def config(self, host_ns: int, kind: str, text: str) -> None:
        self._queue.put(lambda: self._sink.config(host_ns, kind, text))

    def turn(self) -> None:
        """Write what is queued; waits a moment when nothing is."""
        try:
            self._queue.get(timeout=0.05)()
        except queue.Empty:
            return

    def drain(self) -> None:
        """Write everything that is still queued, after the threads have ended."""
        while not self._queue.empty():
            self._queue.get()()
