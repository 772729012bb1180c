"""`legid compensate`: what a named cause does to a leg is undone by the drive, as recorded on emulated drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq import InputError
from daq.recording import write_plan
from drivers.errors import DeviceFault
from experiments.cli.main import main
from experiments.emulation.hidden_effects import EFFECTS, NOTHING
from experiments.models import EffectValue, save_model
from experiments.workflows import cogging_settings, feedforward, shares_of
from tests.support.compensated_leg import DIRECT, PLAN, RIPPLE, SPRING, VALUE, apart, direct, extended, record
from tests.support.drive_bench import DriveBench


def test_a_cogging_table_in_a_moteus_makes_the_leg_the_one_without_ripple(tmp_path: Path) -> None:
    model = extended(tmp_path, VALUE)
    rig, _ = direct("moteus")
    settings = cogging_settings(model, rig, DIRECT.__getitem__, "m.json")
    assert len(settings) == 1025 and max(map(abs, list(settings.values())[1:])) == 127.0
    clean = record(tmp_path, "moteus", PLAN, NOTHING)
    before = apart(record(tmp_path, "moteus", PLAN, RIPPLE), clean)
    after = apart(record(tmp_path, "moteus", PLAN, RIPPLE, settings), clean)
    assert before > 0.03 and after < 0.1 * before, (before, after)


@pytest.mark.parametrize("kind", ["legid", "odrive", "dynamixel"])
def test_torque_added_to_a_plan_makes_the_leg_the_one_without_a_spring(kind: str, tmp_path: Path) -> None:
    found = feedforward(extended(tmp_path, SPRING), PLAN, "m.json")
    assert found.after < 0.1 * found.before
    clean = record(tmp_path, kind, PLAN, NOTHING)
    before = apart(record(tmp_path, kind, PLAN, EFFECTS["joint_stiffness"]), clean)
    after = apart(record(tmp_path, kind, found.plan, EFFECTS["joint_stiffness"]), clean)
    assert before > 0.1 and after < 0.15 * before, (before, after)


def test_a_table_survives_a_loss_of_supply_only_when_it_was_written_whole() -> None:
    bench = DriveBench("moteus")
    bench.drive.open()
    bench.drive.configure({"motor.cogging_dq_scale": 0.01, "motor.cogging_dq_comp.3": -7.0})  # type: ignore[attr-defined]
    bench.far.power_cycle()
    assert bench.far.config["motor.cogging_dq_comp.3"] == -7.0
    with pytest.raises(DeviceFault, match="refuses motor"):
        bench.drive.configure({"motor.cogging_dq_comp.3": 9.0, "motor.no_such": 1.0})  # type: ignore[attr-defined]
    bench.far.power_cycle()
    assert bench.far.config["motor.cogging_dq_comp.3"] == -7.0


def test_who_compensates_is_said_and_a_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]
                                                              ) -> None:
    gyro = EffectValue(name="gyro_bias", joint=None, sizes={"bias": 0.01}, shapes={})
    model = extended(tmp_path, VALUE, SPRING, gyro)
    assert [share.where for share in shares_of(model, "moteus")] == ["drive", "plan", "nowhere"]
    assert [share.where for share in shares_of(model, "odrive")] == ["plan", "plan", "nowhere"]
    save_model(model, tmp_path / "m.json")
    (tmp_path / "rig.toml").write_text(direct("moteus")[1])
    write_plan(PLAN, tmp_path / "plan.csv")
    command = ["compensate", str(tmp_path / "m.json"), "--rig", str(tmp_path / "rig.toml")]
    assert main([*command, "--plan", str(tmp_path / "plan.csv"), "--out", str(tmp_path / "new.csv")]) == 0
    said = capsys.readouterr().out
    assert "Dry run" in said and "legid calibrate imu" in said and "rad rms before" in said
    assert (tmp_path / "new.csv").read_text().startswith("time_s,tau2_cmd_nm")


def test_a_drive_without_a_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no table of torque"):
        cogging_settings(extended(tmp_path, VALUE), direct("odrive")[0], lambda name: 1.0, "m.json")
    with pytest.raises(InputError, match="periods a turn"):
        cogging_settings(extended(tmp_path, VALUE), direct("moteus")[0], lambda name: 0.5, "m.json")


def test_writing_asks_the_drive_and_leaves_its_motor_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                         capsys: pytest.CaptureFixture[str]) -> None:
    for kind, status in (("moteus", 0), ("odrive", 2)):
        bench = DriveBench(kind, turns=1.0, gear_ratio=1.0)
        monkeypatch.setattr("experiments.rig.connect", lambda device, rig, bench=bench: bench.drive, raising=False)
        save_model(extended(tmp_path, VALUE), tmp_path / f"{kind}.json")
        (tmp_path / "rig.toml").write_text(direct(kind)[1])
        command = ["compensate", str(tmp_path / f"{kind}.json"), "--rig", str(tmp_path / "rig.toml"), "--write"]
        assert main(command) == status
        assert not bench.far.record[1].any()
        said = capsys.readouterr()
        assert ("written, read back and kept" in said.out) == (kind == "moteus")
        assert status == 0 or "no table" in said.err
        if kind == "moteus":
            assert bench.far.config["motor.cogging_dq_scale"] > 0.0
