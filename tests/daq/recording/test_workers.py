"""Real-time priority: asked for, said whether granted, and given back."""

import os
import threading

import pytest

from daq.recording.workers import hurry, real_time
from tests.support.processes import REAL_CLOCK

pytestmark = REAL_CLOCK


def test_threads_started_meanwhile_have_it_and_it_is_given_back() -> None:
    before, inside = os.sched_getscheduler(0), []
    with real_time() as granted:
        thread = threading.Thread(target=lambda: inside.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert inside == [os.SCHED_RR if granted else before]
    assert os.sched_getscheduler(0) == before


def test_without_the_right_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time() as granted:
        assert granted is False


def test_it_is_given_back_when_something_fails() -> None:
    before = os.sched_getscheduler(0)
    with pytest.raises(ZeroDivisionError), real_time():
        _ = 1 / 0
    assert os.sched_getscheduler(0) == before


def test_a_thread_that_was_there_before_can_have_it_too() -> None:
    ending = threading.Event()
    thread = threading.Thread(target=ending.wait)
    hurry(thread)  # not started: nobody else is given it
    before = os.sched_getscheduler(0)
    thread.start()
    with real_time() as granted:
        hurry(thread)
    assert os.sched_getscheduler(thread.native_id or -1) == (os.SCHED_RR if granted else before)
    assert os.sched_getscheduler(0) == before
    ending.set()
    thread.join()
