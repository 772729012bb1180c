"""A recording whose current sensor is at the end of its range: said when it ends, by info, by runs and by a fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.recording import write_plan
from drivers.mock.emulator import FirmwareEmulator
from experiments.excite import random_multisine
from tests.support.paths import DEMO_RIG
from tests.support.shell import Shell

RANGE_A = 0.5


@pytest.mark.parametrize("clipped", [False, True])
def test_a_clipped_current_is_told_from_the_recording_on(clipped: bool, here: Path, monkeypatch: pytest.MonkeyPatch,
                                                         shell: Shell) -> None:
    whole = FirmwareEmulator._telemetry

    def within(self: FirmwareEmulator, *args: object) -> object:
        frame = whole(self, *args)  # type: ignore[arg-type]
        return replace(frame, current_a=float(np.clip(frame.current_a, -RANGE_A, RANGE_A))) if clipped else frame

    monkeypatch.setattr(FirmwareEmulator, "_telemetry", within)
    # else the supervisor stops the motor
    (here / "rig.toml").write_text(DEMO_RIG.read_text().replace("[limits]", "[limits]\ntorque_band_nm = 0.6"))
    write_plan(random_multisine(7, 4.0, 0.6), here / "plan.csv")
    shell("record --rig rig.toml --plan plan.csv --out run.mcap --emulate")
    told = "tau2_nm stands at exactly"
    assert (told in shell.err) == clipped
    for command, fault in (("info run.mcap", told), ("runs .", "faulty readings"),
                           ("fit run.mcap --rig rig.toml", told)):
        shell(command)
        assert (fault in shell.out) == clipped
