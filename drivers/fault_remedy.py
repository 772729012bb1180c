"""Remedies to try before a latched fault is cleared: clearing alone starts a hot or broken drive again."""

from __future__ import annotations

from drivers.protocol import ESTOP_OPEN, Fault

CLEAR_FAULTS = "legid doctor --clear-faults --rig RIG"
"""The command that acknowledges faults and has them cleared; a cause that is still there keeps them."""

_LOOK = {
    Fault.WATCHDOG: "check the cable and what keeps this computer busy, unless the program was killed or suspended",
    Fault.OVERCURRENT: "look for a joint that is blocked and for a short in the motor or its wires",
    Fault.OVERTEMPERATURE: "let the motor cool, and plan less torque",
    Fault.UNDERVOLTAGE: "check the supply, its plug and its current limit",
    Fault.OVERVOLTAGE: "check the supply, which must take back what the motor gives when it brakes",
    Fault.KNEE_ENCODER: "check the knee's encoder and its cable",
    Fault.KNEE_HALL: "check the motor's Hall sensors and their cable",
    Fault.COMMAND_LIMIT: "lower [limits] torque_nm to the firmware's limit",
    Fault.OVERSPEED: "look whether the knee runs free, and plan less torque",
    Fault.GATE_DRIVER: "look for a short and a burnt power stage",
    Fault.INTERNAL: "the firmware broke off: keep the run for its author, and power-cycle the controller",
    Fault.ESTOP: "see that nobody is near, and release the emergency stop",
    Fault.POSITION_LIMIT: "turn the knee back between the drive's limits by hand",
}


def fault_remedy(faults: int) -> str:
    """Remedies for each of `faults` (bits of `Fault`), then the command that clears them: one line."""
    looks = [look for fault, look in _LOOK.items() if faults & fault]
    if faults & ESTOP_OPEN and not faults & Fault.ESTOP:
        looks.append(_LOOK[Fault.ESTOP])
    if faults & ~(ESTOP_OPEN | sum(_LOOK)):
        looks.append("find the bit in the firmware's manual")
    return "; ".join([*looks, f"then {CLEAR_FAULTS}"])
