"""A part of the example board's fault matrix, and what the study calls wrong."""

from pathlib import Path

import pytest

from evidence.port_faults import wrong
from tests.support.port_bench import Outcome, prompt
from tests.support.processes import REAL_CLOCK, evidence
from tests.support.qemu_board import CC, QEMU, needs

SOUND = Outcome(98.0, "board", False, 0.4, 1, "stopped by SIGTERM", "whole", "FAULT, watchdog", True)
CHOSEN = ("nothing comes up", "nothing goes down", "command of the invalid value", "Hello of protocol version 2",
          "armed without a clear", "tick stands still", "SIGKILL")


@pytest.mark.slow
@REAL_CLOCK
def test_the_board_survives_faults(tmp_path: Path) -> None:
    """In a process of its own, which forks its recordings and must have no threads."""
    needs(CC, QEMU)
    with prompt():  # skips where the study could not run
        pass
    out = tmp_path / "faults.md"
    evidence("port-faults", "--only", *CHOSEN, "--moments", "driving", "--boards", 1, "--out", out)
    text = out.read_text()
    assert "\nNothing: " in text and "protocol version 2, this program version 1" in text


@pytest.mark.parametrize("name, changes, what", [
    ("line cut both ways", {}, ""),
    ("line cut both ways", {"zero_ms": 110.5}, "torque for 110 ms"),
    ("line cut both ways", {"zero_ms": 650.0, "driven_on": True}, "driven to the plan's end"),
    ("SIGTERM", {"strongest_nm": 0.6}, "driven with 0.60 N m"),
    ("SIGTERM", {"board": "ARMED"}, "armed at the end"),
    ("SIGTERM", {"status": 70, "said": "Traceback: ValueError"}, "status 70: Traceback: ValueError"),
    ("SIGKILL", {"status": -9, "said": ""}, ""),
    ("every frame twice, from the board", {"zero_ms": 650.0, "driven_on": True, "status": 0, "said": ""}, ""),
    ("SIGTERM", {"struck": False}, "the recording ended before the fault came, time and again"),
])
def test_what_is_wrong(name: str, changes: dict[str, object], what: str) -> None:
    assert wrong(name, "driving", SOUND._replace(**changes)) == what  # type: ignore[arg-type]
