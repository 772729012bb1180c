"""The shared cases of faulty inputs, each through the command that a user types. Skipped where they are not there."""

from pathlib import Path

import numpy as np
import pytest

from experiments.exchange.column_map import load_map
from legid.cli import main
from tests.support.paths import CASES
from tests.support.shell import Shell, document, typed

pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not next to the checkout")
LEG = {"beta1": 0.10128, "beta2": 0.02368, "beta3": 0.0336, "beta4": 0.384, "beta5": 0.112}
PENDULUM = {"beta1": 0.05, "beta2": 0.12}


def samples_of(run: Path) -> np.ndarray:
    return np.loadtxt(run, delimiter=",", skiprows=1)


@pytest.mark.parametrize("run, rig, truth, percent, told", [
    ("torque_clipped/r1.csv", "rig.toml", LEG, 2.0, "stands at exactly +-1.2 N m in 11 % of the samples"),
    ("torque_clipped/r6.csv", "rig.toml", LEG, 2.0, "stands at exactly +-1.2 N m in 14 % of the samples"),
    ("torque_clipped/clip0.6_r1.csv", "rig.toml", LEG, 2.0, "stands at exactly +-0.6 N m in 38 % of the samples"),
    ("encoder_wrap/wrap.csv", "rigj.toml", PENDULUM, 0.5, "q1_rad jumps by 6.283 rad 14 times"),
    ("encoder_wrap/leg.csv", "leg_rig.toml", LEG, 0.5, "q2_rad jumps by 3.142 rad 28 times"),
    ("encoder_one_bad_reading/glitch1.csv", "rigj.toml", PENDULUM, 0.5, "off in one reading by 3.14 rad (row 901)"),
    ("encoder_one_bad_reading/leg.csv", "leg_rig.toml", LEG, 0.5, "off in one reading by 3.14 rad (row 702)"),
    ("encoder_rezero/rezero.csv", "rigj.toml", PENDULUM, 1.0, "q1_rad steps by 0.37 rad at 8.0"),
    ("encoder_rezero/leg.csv", "leg_rig.toml", LEG, 1.0, "q2_rad steps by 0.368 rad at 8.0")])
def test_a_fit_names_the_readings_and_is_right(run: str, rig: str, truth: dict[str, float], percent: float, told: str,
                                               shell: Shell) -> None:
    file = CASES / run
    found = document("fit", file, "--rig", file.parent / rig)
    assert told in shell.out
    values = {one["name"]: one["value"] for one in found["parameters"]}
    assert {name: values[name] for name in truth} == pytest.approx(truth, rel=percent / 100.0)
    assert found["readings"] and found["trust"]["sentence"].startswith("TRUST")


def test_a_gyro_of_a_wrong_scale_is_named_and_not_trusted(shell: Shell) -> None:
    folder = CASES / "imu_gyro_scale"
    assert main(["fit", str(folder / "r4.csv"), "--rig", str(folder / "rig.toml")]) in (0, 1)
    said = shell.read()
    assert said.out.startswith("DO NOT TRUST the parameters: a sensor's scale is wrong")
    assert "scale error -0.15" in said.out and "run legid diagnose" in said.out and "richer" not in said.err


@pytest.mark.parametrize("file, options, columns", [
    ("clock_text/iso.csv", "", "q1_rad tau1_nm"), ("clock_text/german.csv", "", "q1_rad tau1_nm"),
    ("header_units/u_ndot.csv", "", "q1_rad tau1_nm"), ("header_units/ni.csv", "", "q1_rad tau1_nm"),
    ("encoder_wrap/wrap_imp.csv", "", "q1_rad tau1_nm"), ("rate_with_guess/notime.csv", "--rate 200", "q1_rad tau1_nm"),
    ("single_column/swing_head.txt", "--rate 500", "q1_rad"),
    ("torque_absent_two_angles/free.csv", "", "q1_rad q2_rad"),
    ("torque_absent_two_angles/free_u.csv", "", "q1_rad q2_rad"),
    ("parquet_lists/episode_000000.parquet", "", "q1_rad q1_cmd_rad load1_raw")])
def test_an_import_finds_the_columns(file: str, options: str, columns: str, tmp_path: Path) -> None:
    path, target = CASES / file, tmp_path / "c.toml"
    typed("import", path, "--guess --map", target, options)
    assert set(load_map(target)) - {"time_s"} == set(columns.split())
    typed("import", path, "--map", target, "--out", tmp_path, options)
    (run,) = tmp_path.glob("*.csv")
    times = samples_of(run)[:, 0]
    steps = np.diff(times)
    assert len(times) >= 999 and np.median(steps) == pytest.approx(steps.mean(), rel=1e-3)


@pytest.mark.parametrize("file, status, told", [
    ("clock_text/openlog.csv", 2, "give --rate HZ"), ("clock_text/excel.csv", 2, "its times have 7 digits only"),
    ("torque_denormal/denormal.csv", 2, "'effort' holds no torque"),
    ("no_time_message/no_time.csv", 2, "give its rate by --rate HZ"),
    ("mat_only_objects/only_objects.mat", 2, "theta, phi_dot, i_m, u are MATLAB timeseries objects, which only MATLAB"),
    ("force_as_angle/force.csv", 1, "no name says which of them is the torque of which joint")])
def test_an_import_asks_for_what_it_cannot_know(file: str, status: int, told: str, tmp_path: Path,
                                                shell: Shell) -> None:
    shell("import", CASES / file, "--guess --map", tmp_path / "c.toml", status=status)
    said = shell.err
    assert told in said and "sort the rows" not in said and "internal error" not in said


def test_one_column_is_read_by_a_map(tmp_path: Path) -> None:
    folder = CASES / "single_column"
    typed("import", folder / "swing.txt", "--map", folder / "map.toml", "--rate 500 --out", tmp_path)
    assert len(samples_of(tmp_path / "swing.csv")) == 4000


@pytest.mark.parametrize("file, map_of, samples, missing", [
    ("moves_said_still/whirl.csv", "hip_deg", 2000, 0), ("moves_said_still/small_then_large.csv", "angle_deg", 2000, 0),
    ("moves_said_still/spin_up.csv", "angle_deg", 1600, 0), ("encoders_zero_for_moments/good.csv", "hip_deg", 2000, 0),
    ("encoders_zero_for_moments/lost.csv", "hip_deg", 2000, 30)])
def test_good_readings_stay(file: str, map_of: str, samples: int, missing: int, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(f'[columns.time_s]\nname = "time"\n[columns.q1_rad]\nname = "{map_of}"\n'
                                     'unit = "deg"\n[columns.tau1_nm]\nname = "torque_nm"\n')
    run = "import", CASES / file, "--map", tmp_path / "m.toml", "--out"
    typed(*run, tmp_path / "runs")
    typed(*run, tmp_path / "as_read", "--as-read")
    whole, used = (samples_of(tmp_path / folder / Path(file).name) for folder in ("as_read", "runs"))
    assert len(whole) == samples and samples - missing <= len(used) + (missing > 0) <= samples
    steps = np.rint(100.0 * (used[:, 0] - whole[0, 0])).astype(int)
    np.testing.assert_allclose(used[:, 1], whole[steps, 1], atol=1e-12)


def test_a_swing_that_comes_to_rest_is_imported(tmp_path: Path) -> None:
    typed("import", CASES / "swing_then_rest/swing.csv", "--yes --out", tmp_path)
    assert len(samples_of(tmp_path / "swing.csv")) == 280


@pytest.mark.parametrize("rig", ["rig.toml", "rig_zero.toml"])
@pytest.mark.parametrize("file", ["zero0.csv", "zero4.csv"])
def test_a_free_swing_has_its_zero_estimated(file: str, rig: str, tmp_path: Path,
                                            shell: Shell) -> None:
    folder = CASES / "free_swing_zero_off"
    typed("import", folder / file, "--map", folder / "map.toml", "--out", tmp_path)
    found = document("fit", tmp_path / file, "--rig", folder / rig, "--fix beta2=1")["parameters"][0]
    assert found["name"] == "beta1" and found["value"] == pytest.approx(1.258, rel=6e-3)
    assert ("q1 hangs at 0.070 rad, not at 0" in shell.out) == (file == "zero4.csv" and rig == "rig.toml")


@pytest.mark.parametrize("file", ["pendulum.csv", "two.csv", "without.csv"])
def test_one_angle_in_several_columns_is_one_joint(file: str, tmp_path: Path,
                                                  shell: Shell) -> None:
    target = tmp_path / "c.toml"
    shell("import", CASES / "same_angle_thrice" / file, "--guess --map", target)
    assert set(load_map(target)) == {"time_s", "q1_rad", "tau1_nm"}
    assert shell.err.count(" again (correlation") == {"pendulum.csv": 2, "two.csv": 1}.get(file, 0)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_no_warning_of_python_reaches_a_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    folder = CASES / "numpy_warning"
    assert main(["fit", str(folder / "slide.csv"), "--rig", str(folder / "rig.toml")]) in (0, 1)
    assert "RuntimeWarning" not in capfd.readouterr().err
