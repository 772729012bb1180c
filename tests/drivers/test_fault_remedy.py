"""What is said of a latched fault: every one has something to look at first, and the command is one that exists."""

import pytest

from drivers import fault_remedy
from drivers.fault_remedy import CLEAR_FAULTS
from drivers.protocol import ESTOP_OPEN, Fault
from legid.cli.main import build_parser


@pytest.mark.parametrize("fault", Fault)
def test_every_fault_has_something_to_look_at_before_it_is_cleared(fault: Fault) -> None:
    look, clear = fault_remedy(fault).rsplit("; ", 1)
    assert look and "manual" not in look
    assert clear == f"then {CLEAR_FAULTS}"


def test_several_faults_are_one_line_and_the_command_comes_once() -> None:
    text = fault_remedy(Fault.WATCHDOG | Fault.OVERTEMPERATURE | ESTOP_OPEN | 1 << 14)
    assert "\n" not in text and text.count("legid doctor") == 1
    for words in ("killed", "cool", "release the emergency stop", "firmware's manual"):
        assert words in text


def test_an_emergency_stop_is_asked_for_once() -> None:
    assert fault_remedy(Fault.ESTOP | ESTOP_OPEN).count("emergency stop") == 1


def test_the_command_is_one_that_legid_has() -> None:
    args = build_parser().parse_args(CLEAR_FAULTS.split()[1:])
    assert args.clear_faults and args.rig == "RIG"
