"""A case of a study has an end, and a late one is told apart from one that fails."""

import signal

import pytest

from evidence import servos
from evidence.processor_time import within_processor_time


def never() -> int:
    while True:
        try:
            sum(range(1000))
        except Exception:  # as a program may that knows failures
            continue


def test_a_case_that_goes_on_is_ended_by_its_processor_time() -> None:
    assert within_processor_time(never, 0.2) is None
    assert within_processor_time(lambda: 3, 10.0) == 3
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGPROF) == signal.SIG_DFL


def test_what_a_case_raises_is_raised() -> None:
    with pytest.raises(ValueError, match="no such case"):
        within_processor_time(lambda: int("no such case"), 1.0)


def test_a_late_diagnosis_is_a_row_that_names_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(servos, "MOST_S", 0.05)
    which = next(k for k, one in enumerate(servos.CAUSES) if one.effect == "command_delay")
    said = servos.diagnose.__wrapped__(which, 8905)  # type: ignore[attr-defined]
    assert (said.verdict, said.causes) == (servos.LATE, ())
    page = "\n".join(servos.hidden([(servos.CAUSES[which], 8905, said)]))
    assert "| hidden cause in the answer | 0/1" in page and f"| command_delay | 8905 | {servos.LATE} | - |" in page
