"""A thinned count of faults; `make nth-fault` fails every operation."""

from pathlib import Path

import pytest

from daq import WorkError
from tests.support.nth_fault import DRIVES, FAULTS, strike

TARGET_MS = 110.0


@pytest.mark.parametrize("drive", [pytest.param(name, marks=[] if name in ("legid", "odrive") else [pytest.mark.slow])
                                   for name in DRIVES])
def test_a_recording_whose_nth_operation_fails_stops_keeps_and_says_why(drive: str, tmp_path: Path) -> None:
    strides = {"write": 29, "flush": 13, "sync": 3}
    found, counts = strike(drive, lambda kind, n: n % strides.get(kind, 450) == 1, tmp_path)
    assert set(counts) == set(FAULTS) == {one.kind for one in found}
    for one in found:
        assert one.named and one.readable and one.zero_ms <= TARGET_MS, one


def test_the_last_operations_are_not_swallowed(tmp_path: Path) -> None:
    """While the controller is asked whether its motor is off, nothing may break off; what failed is said afterwards."""
    _, counts = strike("dynamixel", lambda kind, n: False, tmp_path)
    (tmp_path / "dynamixel.mcap").unlink()
    last = counts["write"] - 25
    found, _ = strike("dynamixel", lambda kind, n: kind == "write" and n >= last, tmp_path)
    assert len(found) > 5 and all(one.named for one in found), found


def test_a_count_that_finds_nothing_wrong_would_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the cause is not in the message it is seen."""
    monkeypatch.setitem(FAULTS, "write", (WorkError("something"), "No space left on device"))
    found, _ = strike("odrive", lambda kind, n: kind == "write" and n == 60, tmp_path)
    assert [one.named for one in found] == [False]
