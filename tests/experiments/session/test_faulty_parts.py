"""Runs that are not what they seem: zeros that are wrong or change, lost samples, starts with a hand on the leg."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from daq import Dataset, FloatArray, parse_rig
from daq.runs import RawTable
from daq.timing import align_table
from experiments.session import prepare, setup_of, with_lost_samples
from experiments.workflows import fit_runs
from tests.support.driven_pendulum import BETA, pendulum_run
from tests.support.imported_files import table_of
from tests.support.motions import pendulum
from tests.support.mujoco_leg import Leg, record
from tests.support.runs import with_columns
from tests.support.servo_joint import GAIN, servo_run
from tests.support.shell import Shell, document, values

STEPPED = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[sampling]\nrate_hz = 50.0\n'


@pytest.mark.parametrize("first, zero", [(40, 0.0), (260, 0.0), (40, 0.5), (260, 0.5)])
def test_the_part_whose_zero_explains_the_torque_is_kept(first: int, zero: float, tmp_path: Path) -> None:
    run = pendulum_run("r", 5)
    behind = np.arange(len(run)) >= first
    read = run["q1_rad"] + np.where(behind, 0.5, 0.0) - zero  # zero 0.5: the part behind the step is right
    (found,) = prepare([table_of(run, tmp_path / "r.csv", q1_rad=read)], parse_rig(STEPPED)).setup.datasets
    assert_allclose(found["q1_rad"], run["q1_rad"], atol=0.02)
    assert any("its zero has changed" in str(flag) for flag in found.told)


def test_a_clipped_torque_is_told_in_every_form(here: Path, shell: Shell) -> None:
    run = pendulum_run("r", 6)
    torque = np.clip(run["tau1_nm"], -0.6, 0.6)
    file, rig = table_of(run, here / "r.csv", tau1_nm=torque), here / "rig.toml"
    rig.write_text(STEPPED)
    told = "tau1_nm stands at exactly +-0.6 N m"
    shell("info", file)
    assert told in shell.out
    (fault,) = document("fit", file, "--rig rig.toml")["readings"]
    assert told in shell.out
    assert (fault["run"], fault["column"], fault["what"], fault["done"]) == ("r.csv", "tau1_nm", "clipped", "left_out")
    assert sum(b - a + 1 for a, b in fault["rows"]) == np.sum(np.abs(torque) == 0.6)


JOINT = '[mechanism]\nmodel = "joint1"\nactuated = {}\n'
SERVO = JOINT.format([1]) + "[servo]\ngain = {}\ndamping = 0.1\nlimit = 100.0\n"


def off(data: Dataset, zero: float) -> Dataset:
    return replace(data, columns={name: x + zero if name.startswith("q1") else x for name, x in data.columns.items()})


MADE = {
    "a free swing": (lambda: swing(0.0, 0.9, 80.0, (0.1, 0.1)), JOINT.format([]), {"beta2": 0.08}, -0.12),
    "a driven joint": (lambda: pendulum_run("r", 3), JOINT.format([1]), {}, 0.06),
    "a servo": (servo_run, SERVO.format(GAIN), {}, 0.08)}


@pytest.mark.parametrize("made", MADE)
def test_a_zero_that_is_not_hanging_is_estimated_and_told(made: str) -> None:
    make, text, fixed, zero = MADE[made]
    run, rig = make(), parse_rig(text)
    healthy = prepare([run], rig, choose=True, fixed=fixed)
    assert not [choice for choice in healthy.choices if choice.key == "encoder_zero"]
    found = prepare([off(run, zero)], rig, choose=True, fixed=fixed)
    (choice,) = [choice for choice in found.choices if choice.key == "encoder_zero"]
    told = re.search(r"q1 hangs at (\S+) rad, not at 0", str(choice))
    assert choice.value == (1,) and told is not None and float(told[1]) == pytest.approx(zero, abs=5e-3)
    difference = found.setup.datasets[0]["q1_rad"] - run["q1_rad"]
    assert np.nanmax(np.abs(difference)) < 6e-3 and np.nanstd(difference) < 1e-9
    asked = prepare([off(run, zero)], parse_rig(f"{text}[terms]\nencoder_zero = [1]\n"), fixed=fixed)
    assert np.nanmax(np.abs(asked.setup.datasets[0]["q1_rad"] - run["q1_rad"])) < 6e-3
    assert any("encoders' zeros are taken off" in note for note in asked.setup.notes)


def test_the_fit_has_the_parameters_of_the_true_zero() -> None:
    run, rig = pendulum_run("r", 3), parse_rig(JOINT.format([1]))
    right = fit_runs([run], rig, method="wls").result.beta
    repaired = fit_runs([off(run, 0.06)], rig, method="wls").result.beta
    assert_allclose(repaired[:2], right[:2], rtol=0.02)
    assert_allclose(repaired[:2], BETA[:2], rtol=0.05)


def test_a_zero_that_no_gravity_shows_is_asked_for() -> None:
    """About hanging a wrong zero of 3 degrees is a constant torque."""
    time = np.arange(600) / 50.0
    angle = 0.02 * np.sin(3.0 * time) + 0.01 * np.sin(7.0 * time + 1.0)
    angle += 1e-4 * np.random.default_rng(1).normal(size=600)
    torque = 0.1 * np.gradient(np.gradient(angle, time), time) + 1.2 * np.sin(angle)
    run = Dataset("small", 50.0, time, {"q1_rad": angle + 0.05, "tau1_nm": torque})
    found = prepare([run], parse_rig(JOINT.format([1]) + "[terms]\nencoder_zero = [1]\n"))
    assert_array_equal(found.setup.datasets[0]["q1_rad"], run["q1_rad"])
    assert any("gravity does not show where the joints of encoder_zero hang" in note for note in found.setup.notes)


IMU = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
ENCODERS = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
GYRO = ("gyro_radps", "accel_x_mps2", "accel_y_mps2")


def lose(x: FloatArray, row: int, count: int) -> FloatArray:
    """x (n,) without `count` samples from `row` on, or with the last ones twice where negative."""
    out = np.concatenate([x[:row], x[row + count:]])
    return np.concatenate([out, np.full(max(x.size - out.size, 0), out[-1])])[:x.size]


def leg(seed: int, rig: str, columns: tuple[str, ...] = (), row: int = 0, count: int = 0) -> tuple[Dataset, Dataset]:
    """A run before and after `columns` lose samples."""
    run = record(Leg(), seed)
    names = ("q2_rad", "tau2_nm", *(GYRO if rig is IMU else ("q1_rad",)))
    right = replace(run, columns={name: run[name] for name in names})
    return right, with_columns(right, **{name: lose(right[name], row, count) for name in columns})


def corrected(data: Dataset, rig: str) -> Dataset:
    setup = setup_of([data], parse_rig(rig))
    (found,) = with_lost_samples(setup.datasets, setup.mechanism, setup.options)
    return found


@pytest.mark.parametrize("rig, columns", [(IMU, ("q2_rad",)), (ENCODERS, ("q2_rad",)), (ENCODERS, ("tau2_nm",))])
@pytest.mark.parametrize("row, count", [(900, 4), (1300, -3)])
def test_lost_samples_are_named_and_moved_back(rig: str, columns: tuple[str, ...], row: int, count: int) -> None:
    right, wrong = leg(3, rig, columns, row, count)
    found = corrected(wrong, rig)
    faults = found.readings
    assert {fault.what for fault in faults} == {"lost"} and len({fault.rows for fault in faults}) == 1
    assert abs(faults[0].rows[0][0] - row) < 50 and abs(faults[0].size) == abs(count)
    assert ("lost 4 samples" in str(faults[0])) == (faults[0].size == 4)
    far = np.abs(np.arange(len(right)) - row) > 60  # slow motion places a row no better
    if faults[0].column in columns:
        difference = found[columns[0]][far] - right[columns[0]][far]
    else:  # the others, by as much the other way: then all columns agree on that other time
        moved = lose(right[faults[0].column], row, count)
        difference = (found[faults[0].column] - moved)[far]
    assert np.nanmax(np.abs(difference[:-abs(count) - 20])) < 1e-9


@pytest.mark.parametrize("rig", [IMU, ENCODERS])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_healthy_runs_lose_nothing(rig: str, seed: int) -> None:
    right, _ = leg(seed, rig)
    assert corrected(right, rig).readings == ()


@pytest.mark.parametrize("count", [3, -5])
def test_a_constant_delay_is_no_loss(count: int) -> None:
    right, _ = leg(3, ENCODERS)
    late = with_columns(right, tau2_nm=np.roll(right["tau2_nm"], count))
    assert corrected(late, ENCODERS).readings == ()


def test_a_fit_of_a_run_with_lost_samples_is_right(here: Path, shell: Shell) -> None:
    run = pendulum_run("r", 4)
    (here / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
    file = table_of(run, here / "r.csv", tau1_nm=lose(run["tau1_nm"], len(run) // 2, 4))
    found = document("fit", file, "--rig rig.toml")
    assert "against the other columns at about" in shell.out
    assert values(found)[0] == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("columns, count", [(("q2_rad",), 17), (("q2_rad",), 29), (("tau2_nm",), -14)])
def test_many_lost_samples_are_named_and_not_the_motion(columns: tuple[str, ...], count: int) -> None:
    right, wrong = leg(4, ENCODERS, columns, 1000, count)
    faults = corrected(wrong, ENCODERS).readings
    assert {fault.what for fault in faults} == {"lost"} and abs(faults[0].size) == abs(count)
    assert abs(faults[0].rows[0][0] - 1000) < 50 and corrected(right, ENCODERS).readings == ()


@pytest.mark.parametrize("times, seed", [(2, 3), (4, 4), (6, 5)])
def test_an_imu_that_repeats_its_readings_is_named(times: int, seed: int) -> None:
    """Noise levels that the rig file declares made it a lack of excitation."""
    right, _ = leg(seed, IMU)
    slow = {name: x[::times].repeat(times)[:len(right)] for name, x in right.columns.items() if name in GYRO}
    run = align_table(RawTable("r", right.time_s, {**right.columns, **slow}), right.rate_hz)
    assert {(fault.column, fault.what, fault.size) for fault in run.readings} == {
        (name, "repeated", times) for name in GYRO}
    declared = IMU + "[noise]\ngyro_radps = 0.005\naccel_mps2 = 0.05\ntorque_nm = 0.02\nencoder_rad = 4e-4\n"
    found, wanted = (fit_runs([one], parse_rig(declared), method="wls").result.beta[:5] for one in (run, right))
    assert_allclose(found, wanted, rtol=0.1)


FREE, DRIVEN = JOINT.format([]), JOINT.format([1])


def swing(hold_s: float, start: float, rate_hz: float, friction: tuple[float, float]) -> Dataset:
    """A pendulum that a not quite steady hand holds at `start` [rad] for so long, of inertia 0.02 kg m^2."""
    time = np.arange(round(14.0 * rate_hz)) / rate_hz
    free = time >= hold_s
    angle = start + 0.004 * np.sin(2.0 * np.pi * 1.3 * time) + 1e-4 * np.random.default_rng(3).normal(size=time.size)
    angle[free] = pendulum(time[free] - hold_s, lambda t: 0.0, start, 0.0, friction, 40.0)
    return Dataset("swing", rate_hz, time, {"q1_rad": np.round(angle / 1e-3) * 1e-3})


def braked(hold_s: float) -> Dataset:
    """A driven joint that a brake holds first, against gravity: the drive is on, and its torque does nothing."""
    time = np.arange(1500) / 100.0
    torque = 2.0 * np.sin(2.0 * np.pi * 0.5 * time) + 1.5 * np.sin(2.0 * np.pi * 1.1 * time)
    free = time >= hold_s
    angle = np.full(time.size, 0.7)
    angle[free] = pendulum(time[free], lambda t: np.interp(t, time, torque) / 0.2, 0.7, 0.0, (1.5, 0.0), 20.0)
    return Dataset("braked", 100.0, time, {"q1_rad": angle + 1e-4 * np.random.default_rng(2).normal(size=time.size),
                                           "tau1_nm": torque})


@pytest.mark.parametrize("run, rig, fixed, hold_s", [
    (swing(2.0, 1.1, 100.0, (0.3, 0.2)), FREE, {"beta2": 0.08}, 2.0),
    (swing(4.3, 0.5, 50.0, (0.2, 0.1)), FREE, {"beta2": 0.08}, 4.3),
    (braked(1.6), DRIVEN, {}, 1.6)], ids=["a hand", "a longer hand", "a brake"])
def test_a_start_that_the_mechanism_cannot_explain_is_left_out(
        run: Dataset, rig: str, fixed: dict[str, float], hold_s: float) -> None:
    (found,) = prepare([run], parse_rig(rig), fixed=fixed).setup.datasets
    (fault,) = found.readings
    assert (fault.what, fault.done) == ("start", "left_out") and "no motion of the mechanism alone" in str(fault)
    assert hold_s - 0.05 <= fault.size <= hold_s + 0.8
    good = found.time_s >= fault.size
    assert_array_equal(found["q1_rad"][good], run["q1_rad"][good])
    assert np.isnan(found["q1_rad"][~good]).all()
    (as_read,) = prepare([run], parse_rig(f"{rig}[sampling]\nas_read = true\n"), fixed=fixed).setup.datasets
    assert not as_read.gap().any() and [one.what for one in as_read.readings] == ["start"]


@pytest.mark.parametrize("run, rig, fixed", [
    (swing(0.0, 2.4, 100.0, (0.3, 0.2)), FREE, {"beta2": 0.08}),
    (swing(0.0, 0.4, 30.0, (0.8, 0.4)), FREE, {"beta2": 0.08}),
    (pendulum_run("r", 4), DRIVEN, {}), (pendulum_run("r", 5, drag=0.02), DRIVEN, {}),
    (servo_run(), DRIVEN + "[servo]\ngain = 4.0\ndamping = 0.1\nlimit = 100.0\n", {}),
    (Dataset("rest", 50.0, np.arange(600) / 50.0, {
        name: np.append(np.full(300, x[0]), x) for name, x in pendulum_run("r", 6).columns.items()}),
     DRIVEN, {})], ids=["a wide swing", "a short swing", "driven", "with drag", "a servo", "rest first"])
def test_a_start_that_the_mechanism_can_make_stays(run: Dataset, rig: str, fixed: dict[str, float]) -> None:
    (found,) = prepare([run], parse_rig(rig), fixed=fixed).setup.datasets
    assert not [fault for fault in found.readings if fault.what == "start"]
