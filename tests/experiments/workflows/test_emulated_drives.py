"""Emulated drives: recorded, looked at, fitted, played back; a clipped current is told; slow: the hidden spring."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import InputError, WorkError, load_rig, parse_rig
from daq.recording import write_plan
from drivers.mock.emulator import FirmwareEmulator
from experiments.emulation import LegBody, rig_with_drive
from experiments.exchange import load_any_run
from experiments.excite import random_multisine
from experiments.rig import confirm_estop
from tests.support.paths import DEMO_RIG
from tests.support.shell import Answers, Shell, document, read_json, values

KINDS = ("moteus", "odrive", "dynamixel")


def rig_text(kind: str) -> str:
    return rig_with_drive(DEMO_RIG.read_text(), kind)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_on_it_is_recorded_looked_at_fitted_and_played_back(kind: str, here: Path, shell: Shell) -> None:
    shell(*words(here, rig_text(kind), "--emulate", seconds=6.0))
    shell("info r.mcap")
    said = shell.out
    assert "samples lie between request and answer" in said and "jitters by" in said
    rig = load_rig(here / "rig.toml")
    data = load_any_run(here / "r.mcap", rig)
    assert data.clock_bound_s is not None and 2e-4 < data.clock_bound_s < 2e-3
    found = values(document("fit r.mcap --rig rig.toml"))
    assert np.abs(found / LegBody().beta() - 1.0)[:5].max() < 0.01
    shell("record --replay r.mcap --out again.mcap")
    assert "by the limits" not in shell.out
    played = load_any_run(here / "again.mcap", rig)
    assert np.nanmax(np.abs(played["q2_rad"] - data["q2_rad"])) < 1e-6  # played back in our own frames, in urad
    assert played.clock_bound_s == data.clock_bound_s


def words(folder: Path, text: str, *more: str, seconds: float = 5.0) -> tuple[object, ...]:
    """A command that records a plan under this rig file."""
    (folder / "rig.toml").write_text(text)
    write_plan(random_multisine(7, seconds, 0.6), folder / "plan.csv")
    return "record --rig", folder / "rig.toml", "--plan", folder / "plan.csv", "--out", folder / "r.mcap", *more


@pytest.mark.parametrize("kind", KINDS)
def test_a_check_that_it_cannot_make_is_to_be_given_up_by_name(kind: str, tmp_path: Path, shell: Shell) -> None:
    text = "\n".join(line for line in rig_text(kind).splitlines() if not line.startswith("unchecked"))
    shell(*words(tmp_path, text, "--emulate"), status=2)
    assert 'unchecked = ["encoder_s"]' in shell.err


def test_a_drive_that_is_only_read_records_no_plan(tmp_path: Path, shell: Shell) -> None:
    said = shell.fails(*words(tmp_path, rig_text("feetech"), "--emulate"), status=1)
    assert "has no watchdog, so a lost host would leave the torque on" in said


def test_a_drive_asks_for_the_hard_wired_stop_before_anything_is_opened(tmp_path: Path, shell: Shell) -> None:
    record = words(tmp_path, rig_text("moteus").replace("/dev/ttyACM0", str(tmp_path / "no-port")))
    assert "--estop-at-hand" in shell.fails(*record)
    assert "no such port" in shell.fails(*record, "--estop-at-hand", status=1)


def test_the_question_is_answered_by_yes_alone(answers: Answers) -> None:
    rig = parse_rig(rig_text("odrive"))
    for yes in ("y", " Yes "):
        answers(yes)
        confirm_estop(rig, False)
    for no in ("", "n", "j"):
        answers(no)
        with pytest.raises(WorkError, match="no hard-wired emergency stop at hand"):
            confirm_estop(rig, False)
    confirm_estop(rig, True)
    confirm_estop(parse_rig(rig_text("legid")), False)


def test_an_unknown_drive_is_refused_in_a_line() -> None:
    with pytest.raises(InputError, match=r"--drive.*no emulator of vesc"):
        rig_text("vesc")


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=pytest.mark.slow if kind == "moteus" else pytest.mark.study)
                                  for kind in KINDS])
def test_the_hidden_spring_is_named(kind: str, tmp_path: Path, shell: Shell) -> None:
    shell("demo --drive", kind, "--out", tmp_path)
    found = read_json(tmp_path / "diagnosis.json")
    assert found["verdict"] == "named" and [c["effect"] for c in found["causes"]] == ["joint_stiffness"]


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
