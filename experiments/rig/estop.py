"""The hard-wired emergency stop, asked for: a drive without an E-stop input has no other."""

from __future__ import annotations

import sys

from daq import InputError, Rig, WorkError

FLAG = "--estop-at-hand"
QUESTION = "This drive has no E-stop input. Is a hard-wired emergency stop, which takes its supply away, tested and " \
           "within reach? [y/N] "


def confirm_estop(rig: Rig, at_hand: bool) -> None:
    """Confirm the E-stop, unless the rig has legid's firmware or a person says that it is there (`at_hand`, or now).

    Raises `WorkError` where it is not, `InputError` where nobody can be asked.
    """
    device = rig.devices.controller
    if device is None or device.kind == "legid" or at_hand:
        return
    if not sys.stdin.isatty():
        raise InputError(FLAG, "nobody is there to say that a hard-wired emergency stop is at hand",
                         f"give {FLAG} where it is, docs/safety.md says which")
    try:
        answer = input(QUESTION)
    except EOFError:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise WorkError("no hard-wired emergency stop at hand, so nothing was started; docs/safety.md says which")
