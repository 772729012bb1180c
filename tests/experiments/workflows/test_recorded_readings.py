"""A recording whose current sensor is at the end of its range: said when it ends, by info, by runs and by a fit."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from daq.recording import write_plan
from drivers.mock.emulator import FirmwareEmulator
from experiments.excite import random_multisine
from tests.support.shell import Shell

RANGE_A = 0.5


@pytest.mark.parametrize("clipped", [False, True])
def test_a_clipped_current_is_told_from_the_recording_on(clipped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                         shell: Shell) -> None:
    whole = FirmwareEmulator._telemetry

    def within(self: FirmwareEmulator, *args: object) -> object:
        frame = whole(self, *args)  # type: ignore[arg-type]
        return replace(frame, current_a=float(np.clip(frame.current_a, -RANGE_A, RANGE_A))) if clipped else frame

    monkeypatch.setattr(FirmwareEmulator, "_telemetry", within)
    rig, plan, run = tmp_path / "rig.toml", tmp_path / "plan.csv", tmp_path / "run.mcap"
    rig.write_text((files("experiments.workflows") / "demo_rig.toml").read_text(encoding="utf-8").replace(
        "[limits]", "[limits]\ntorque_band_nm = 0.6"))  # else the supervisor stops the motor
    write_plan(random_multisine(7, 4.0, 0.6), plan)
    shell("record --rig", rig, "--plan", plan, "--out", run, "--emulate")
    told = "tau2_nm stands at exactly"
    assert (told in shell.err) == clipped
    for command in (["info", str(run)], ["runs", str(tmp_path)], ["fit", str(run), "--rig", str(rig)]):
        shell(*command)
        out = shell.out
        assert (("faulty readings" if command[0] == "runs" else told) in out) == clipped
