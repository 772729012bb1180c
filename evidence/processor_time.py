"""`within_processor_time`: a case of a study that takes too long ends, and the study goes on."""

import signal
from collections.abc import Callable
from typing import TypeVar

R = TypeVar("R")


class OverTimeError(BaseException):
    """No `Exception`, so that nothing in the program takes it for a failure that it knows."""


def within_processor_time(case: Callable[[], R], seconds: float) -> R | None:
    """What `case` returns; None where this process has computed for so many `seconds` before. For the main thread."""

    def end(*_: object) -> None:
        raise OverTimeError

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        return case()
    except OverTimeError:
        return None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
