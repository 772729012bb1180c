"""How runs are prepared: what is set aside, chosen where rig.toml is silent, and held against the rig in use."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, InputError, load_rig, parse_rig
from daq.runs import RawTable, read_csv
from daq.timing import align_table
from estimator import Finding, FitOptions, fit
from estimator.model import leg2
from experiments.documents import FitDocument
from experiments.judge import STATED, fit_trust, model_contradictions, model_of
from experiments.session import (
    SetAside,
    choose_terms,
    contradictions,
    load_runs,
    prepare,
    require_one_rig,
    usable_runs,
    with_choices,
)
from experiments.session.setup import fit_options
from experiments.workflows import fit_runs
from tests.support.fits import document_of, synthetic_fit
from tests.support.imported_files import table
from tests.support.mujoco_leg import random_leg, record
from tests.support.paths import FIXTURES, REAL, needs_records
from tests.support.prescribed import ARM_RIG, BETA, arm_run, negated, written
from tests.support.runs import with_columns
from tests.support.shell import Shell, document, values

VOLTS = '[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n'


def three_and_a_stuck_one() -> list[Dataset]:
    *runs, bad = (arm_run(k, seconds=6.0) for k in (0, 1, 2, 7))
    return [*runs, replace(locked(bad), name="bad.csv")]


def test_files_and_data_sets_are_prepared_alike(tmp_path: Path) -> None:
    runs = three_and_a_stuck_one()
    rig = parse_rig(ARM_RIG)
    by_file = prepare(written(runs, tmp_path), rig, choose=True)
    by_data = prepare(load_runs(written(runs, tmp_path), rig), rig, choose=True)
    assert [run.run for run in by_file.set_aside] == ["bad.csv"]
    assert (by_file.set_aside, by_file.choices, by_file.rig) == (by_data.set_aside, by_data.choices, by_data.rig)
    for a, b in zip(by_file.setup.datasets, by_data.setup.datasets, strict=True):
        assert a.name == b.name and all(np.array_equal(a[name], b[name]) for name in a.columns)
    assert prepare(runs, rig).choices == ()


def test_what_a_run_was_recorded_on_is_held_against_the_rig_in_use() -> None:
    own = load_rig(FIXTURES / "rig.toml")
    other = parse_rig((FIXTURES / "rig.toml").read_text().replace("lever_arm_m = 0.2", "lever_arm_m = 0.1"))
    path = FIXTURES / "healthy.mcap"
    assert contradictions(prepare([path], own).flags) == []
    found = prepare([path], other)
    assert contradictions(found.flags) == [
        "healthy.mcap was recorded with imu.lever_arm_m = 0.2, the rig file in use says 0.1"]
    assert [one.flag.kind for one in found.flags] == ["rig"] and str(found.flags[0]) in found.warnings
    (run,) = load_runs([path], own)
    require_one_rig([run, replace(run, recorded_on=None), run])
    with pytest.raises(InputError, match="was recorded on another rig than healthy"):
        require_one_rig([run, replace(run, name="other.mcap", recorded_on=other)])


def test_a_silent_rig_file_has_the_terms_that_a_fit_chose() -> None:
    """A validation said "the rig says []" of rotor inertias that the fit itself had chosen."""
    run, silent = arm_run(0, seconds=3.0), parse_rig(ARM_RIG)
    chosen = parse_rig(f"{ARM_RIG}[terms]\ntorque_offset = [1]\nencoder_zero = [1]\n")
    setup = prepare([run], chosen).setup
    model = model_of(fit(setup.datasets, setup.mechanism, setup.options), setup.settings, "linear", ["r"])
    assert model.mechanism.torque_offset == model.mechanism.encoder_zero == (1,)
    found = prepare([run], silent, model=model)
    assert found.setup.settings == setup.settings and found.setup.options.encoder_zeros == (0,)
    assert model_contradictions(model.mechanism, found.setup.settings) == []
    none = prepare([run], parse_rig(f"{ARM_RIG}[terms]\ntorque_offset = []\n"), model=model)
    assert model_contradictions(model.mechanism, none.setup.settings) == [
        "the model was fitted with torque_offset = [1], the rig says none"]
    assert not model_contradictions(model.mechanism, none.setup.settings, STATED), "two fits may choose otherwise"


def test_a_voltage_is_called_so_and_read_again(tmp_path: Path) -> None:
    time = np.arange(60) / 100.0
    angle = {"time_s": time, "q1_rad": 0.1 * np.sin(time)}
    rig = parse_rig(VOLTS)
    (run,) = load_runs([table(tmp_path / "duty.csv", angle | {"duty": 0.5 + 0 * time, "volts": 8.0 + 0 * time})], rig)
    assert np.array_equal(run["voltage1_v"], np.full(60, 4.0)) and "tau1_nm" not in run
    (again,) = load_runs([table(tmp_path / "volts.csv", angle | {"voltage1_v": 4.0 + 0 * time})], rig)
    assert np.array_equal(again["voltage1_v"], run["voltage1_v"])
    with pytest.raises(InputError, match="duty is missing"):
        read_csv(table(tmp_path / "none.csv", angle), rig)
    twice = prepare([run], rig).setup.datasets[0]
    assert np.array_equal(twice["voltage1_v"], run["voltage1_v"])


def test_findings_of_a_fit_have_their_kind_and_stand_in_its_document() -> None:
    runs = three_and_a_stuck_one()
    fitted = fit_runs(runs, parse_rig(ARM_RIG))
    kinds = [one.kind for one in fitted.result.findings]
    assert kinds[0] == "run_set_aside" and fitted.result.warnings[0] == str(fitted.aside[0])
    assert kinds.count("choice") == len([c for c in fitted.choices if c.key != "friction_velocity_radps"])
    document = fitted.as_document(FitDocument).document
    assert {"role": "warning", "kind": "run_set_aside", "text": str(fitted.aside[0])} in document["findings"]
    assert document["assumptions"][-kinds.count("choice"):] == [
        one.text for one in fitted.result.findings if one.kind == "choice"] or "choice" not in kinds


def test_a_fault_of_the_columns_is_the_first_line() -> None:
    wrong = fit_runs([negated(arm_run(1, seconds=6.0), "tau1_nm")], parse_rig(ARM_RIG), choose=False).result
    assert wrong.inadmissible and wrong.remedies[0].startswith("tau1_nm looks negated")
    assert fit_trust(wrong).sentence.startswith("NOT TO BE USED")
    sound = synthetic_fit()
    assert fit_trust(sound).level == "good"
    told = replace(sound, findings=(Finding("fault", "columns", "gyro and accelerometer contradict each other"),))
    assert fit_trust(told).sentence == "NOT TO BE USED: the columns cannot be right."
    assert fit_trust(told).reasons == ("Gyro and accelerometer contradict each other.",)
    said = replace(sound, findings=(Finding("doubt", "rig_contradiction", "run1 was recorded with x = 1"),))
    assert fit_trust(said).sentence == "DO NOT TRUST the parameters: the rig file contradicts a run."
    assert fit_trust(said).reasons[0] == "run1 was recorded with x = 1."
    assert document_of(told).trust.level == "bad"


GOOD = [arm_run(k, seconds=6.0) for k in range(4)]


def locked(run: Dataset) -> Dataset:
    return with_columns(run, q2_rad=np.full(len(run), 0.3))


def torn(run: Dataset) -> Dataset:
    return with_columns(run, q1_rad=np.where(np.arange(len(run)) % 15 == 0, np.nan, run["q1_rad"]))


def stuck(run: Dataset) -> Dataset:
    return with_columns(run, tau1_nm=np.full(len(run), 0.7))


def stranger(run: Dataset) -> Dataset:
    return arm_run(99, seconds=6.0, beta=BETA * np.array([1, 8, 1, 0.1, 5, 1, 1, 1, 1]))


def used(runs: list[Dataset]) -> tuple[tuple[Dataset, ...], tuple[SetAside, ...]]:
    """The runs that are kept, and those that are set aside."""
    return usable_runs(runs, leg2(actuated=(0, 1)), FitOptions(sensors="encoder"))


@pytest.mark.parametrize("spoil, why", [
    (locked, "joint 2 never moves"), (torn, "no segment of 20 samples"), (stuck, "tau1_nm never changes"),
    (stranger, "of another rig"), (lambda run: negated(run, "tau2_nm"), "of another rig"),
    (lambda run: with_columns(run, q1_rad=np.degrees(run["q1_rad"])), "of another rig")])
def test_the_run_is_named_with_the_reason(spoil: object, why: str) -> None:
    bad = replace(spoil(arm_run(7, seconds=6.0)), name="bad.csv")  # type: ignore[operator]
    kept, aside = used([*GOOD[:2], bad, *GOOD[2:]])
    assert [d.name for d in kept] == [d.name for d in GOOD]
    assert [a.run for a in aside] == ["bad.csv"] and why in aside[0].why


def test_good_runs_and_a_single_one_are_kept() -> None:
    assert used(GOOD) == (tuple(GOOD), ())
    assert used([locked(GOOD[0])])[1] == ()
    quiet = [with_columns(run, tau1_nm=np.zeros(len(run))) for run in GOOD]  # free swings are no faults
    assert not used([*GOOD, quiet[0]][:3])[1]


def test_fit_and_validate_go_on_without_it(here: Path, shell: Shell) -> None:
    runs = written([*GOOD, replace(locked(arm_run(8, seconds=6.0)), name="bad.csv")], here)
    (here / "rig.toml").write_text(ARM_RIG)
    found = document("fit", *runs, "--rig rig.toml --model-out model.json")
    assert "Warning: bad.csv is set aside: joint 2 never moves" in shell.out
    assert [a["run"] for a in found["set_aside"]] == ["bad.csv"]
    assert np.allclose(values(found)[:5], BETA[:5], rtol=0.03)
    found = document("validate model.json", *runs[3:], "--rig rig.toml")
    assert "bad.csv is set aside" in shell.err
    assert {r["run"] for r in found["runs"]} == {"run3.csv"}


def test_a_pause_shorter_than_the_grids_step_is_no_hole() -> None:
    """616 Hz with pauses of 5.9 ms, put on 100 Hz: used to be a hole every few samples. Longer ones stay holes."""
    rng = np.random.default_rng(2)
    steps = np.where(rng.random(6000) < 0.05, 5.9e-3, 1.0 / 616.0)
    time = np.cumsum(steps)
    table = RawTable("uneven", time, {"q1_rad": np.sin(3.0 * time)})
    run = align_table(table, 100.0)
    assert np.isfinite(run["q1_rad"]).all()
    assert np.max(np.abs(run["q1_rad"] - np.sin(3.0 * run.time_s) * np.sinc(0.03 / (2.0 * np.pi)))) < 1e-4
    late = align_table(RawTable("pause", time + 0.012 * (time > 4.0), {"q1_rad": np.sin(3.0 * time)}), 100.0)
    assert np.isnan(late["q1_rad"]).any()
    assert np.isnan(align_table(table, 400.0)["q1_rad"]).any()


ARMS = {"dfki_c0": (["00", "01", "02", "03", "04", "05", "06"], [0.05354, 0.05328, 0.03623, 0.24113, 0.18117]),
        "dfki_a0": (["00", "01", "02", "03", "12"], [0.11116, 0.02346, 0.03332, 0.34912, 0.11106])}


def test_terms_that_are_there_are_chosen_and_no_others() -> None:
    silent = parse_rig(ARM_RIG)
    healthy = [arm_run(k) for k in range(5)]
    assert choose_terms(healthy, silent) == ()
    assert not any("chosen" in text for text in fit_runs(healthy, silent).result.assumptions)

    zeros = [(0.05, -0.04), (-0.04, 0.05), (0.03, 0.05), (-0.05, 0.0), (0.01, -0.06)]
    lame = [arm_run(k, offset=(0.1, 0.0), rotor=0.01, zero=zero) for k, zero in enumerate(zeros)]
    chosen = {c.key: c.value for c in choose_terms(lame, silent)}
    assert chosen == {"rotor_inertia": (2,), "torque_offset": (1,), "encoder_zero": (1, 2)}
    fitted = fit_runs(lame, silent)
    assert fitted.rig == with_choices(silent, fitted.choices)
    assert np.allclose(fitted.result.beta[:5], BETA[:5], rtol=0.03)
    assert sum("chosen, where rig.toml is silent" in text for text in fitted.result.assumptions) == 3

    stated = parse_rig(ARM_RIG + "[terms]\nrotor_inertia = []\ntorque_offset = []\nencoder_zero = []\n")
    assert choose_terms(lame, stated) == ()


def test_an_offset_in_a_single_run() -> None:
    run = arm_run(1, offset=(0.0, 0.2), seconds=20.0)
    assert [(c.key, c.value) for c in choose_terms([run], parse_rig(ARM_RIG))] == [("torque_offset", (2,))]



@needs_records
@pytest.mark.parametrize("arm", [pytest.param("dfki_c0", marks=pytest.mark.study),
                                 pytest.param("dfki_a0", marks=pytest.mark.slow)])
def test_real_arms_without_a_specialist(arm: str, tmp_path: Path) -> None:
    """Mechanism, joints, gear and gravity in rig.toml, one command, no option: within 9 % of what is published."""
    runs, published = ARMS[arm]
    rig = tmp_path / "rig.toml"
    rig.write_text(ARM_RIG + "gravity_mps2 = 9.81\n[motor]\ngear_ratio = 6.0\n")
    told = document("fit", *(REAL / arm / f"{run}.csv.gz" for run in runs), "--rig", rig)
    # 0.085 and 0.067; as a fit was with nothing chosen, 0.154 and 0.154
    assert np.max(np.abs(values(told)[:5] / published - 1.0)) < 0.09
    assert {c["key"] for c in told["chosen"]} >= {"rotor_inertia", "encoder_zero", "encoder_rad"}
    assert not told["remedies"]


LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[noise]\n'


@pytest.mark.parametrize("text, known", [
    ("encoder_rad = 0.001", {"encoder_rad": 0.001}),
    ("encoder_rad = [0.001, 0.004]", {"encoder1_rad": 0.001, "encoder2_rad": 0.004}),
    ("accel_mps2 = 0.05", {"accel_mps2": 0.05}),
    ("accel_mps2 = [0.05, 0.08]", {"accel_x_mps2": 0.05, "accel_y_mps2": 0.08}),
    ("torque_nm = [0.02]", {"torque2_nm": 0.02}),
    ("passive_nm = 0.03\ntorque_nm = 0.02", {"passive_nm": 0.03, "torque_nm": 0.02}), ("", {})])
def test_what_the_rig_declares_is_what_the_fit_knows(text: str, known: dict[str, float]) -> None:
    rig = parse_rig(LEG + text)
    assert fit_options(rig, "encoder", {}).noise == known
    assert rig.noise.encoder_of(-1) == known.get("encoder2_rad", known.get("encoder_rad"))


def test_correlations_are_known_by_rising_joint() -> None:
    arm = LEG.replace("[2]", "[2, 1]") + "torque_nm = [0.1, 0.2]\naccel_correlation = -0.2\n"
    options = fit_options(parse_rig(arm + "torque_correlation = [[1.0, 0.3], [0.3, 1.0]]"), "imu", {})
    assert options.noise == {"torque1_nm": 0.1, "torque2_nm": 0.2}
    assert (options.accel_correlation, options.torque_correlation) == (-0.2, ((1.0, 0.3), (0.3, 1.0)))
    assert [options.torque_noise(j, True) for j in (0, 1)] == [0.1, 0.2] and options.torque_noise(0, False) is None


def test_each_encoder_is_believed_as_far_as_it_is_declared() -> None:
    """The pivot's encoder is twenty times as bad as the knee's. Told so, the fit finds what the torque's noise is; told
    that both are as bad, it gives a part of that to the knee's encoder; told the other way round, the noise of both
    joints is far too large."""
    rng = np.random.default_rng(5)
    leg = random_leg(rng)
    run = record(leg, rng, seconds=20.0, torque=0.02)
    data = [with_columns(run, q1_rad=run["q1_rad"] + 0.01 * rng.normal(size=len(run)),
                         q2_rad=run["q2_rad"] + 0.0005 * rng.normal(size=len(run)))]
    alike, told, swapped = (
        fit_runs(data, parse_rig(LEG + f"encoder_rad = {levels}"), sensors="encoder", choose=False).result
        for levels in ("0.01", "[0.01, 0.0005]", "[0.0005, 0.01]"))
    assert told.noise["torque_nm"] == pytest.approx(0.02, rel=0.1) and alike.noise["torque_nm"] < 0.017
    assert np.all(np.abs(told.beta - leg.beta())[:5] < 4.0 * told.std[:5])
    assert swapped.noise["torque_nm"] > 0.025
    assert swapped.noise["passive_joint_nm"] > 20.0 * told.noise["passive_joint_nm"]
