"""Rows of the fault matrix on every drive: the torque ends, and what ended it is named."""

import pytest

from evidence.drive_faults import strike


@pytest.mark.parametrize("kind", ["moteus", "odrive", "dynamixel"])
@pytest.mark.parametrize("name, within_ms, said", [
    ("host killed", 110.0, "killed"), ("motor gives no torque", 110.0, "torque_s tripped"),
    ("gate driver fault", 10.0, "gate driver")])
def test_the_torque_ends_and_the_fault_is_named(kind: str, name: str, within_ms: float, said: str) -> None:
    zero_ms, words = strike(kind, name, "ramp")
    assert zero_ms < within_ms and said in words
