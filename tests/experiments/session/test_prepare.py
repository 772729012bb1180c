"""Files and data sets are prepared alike; what contradicts the rig in use is said; findings are joined once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.dataset import Dataset
from daq.errors import InputError
from daq.rig import load_rig, parse_rig
from daq.runs.csv_run import read_csv
from estimator import fit
from estimator.result import Finding
from experiments.documents import FitDocument
from experiments.judge import model_of
from experiments.judge.trust import STATED, fit_trust, model_contradictions
from experiments.session import prepare
from experiments.session.flags import contradictions, require_one_rig
from experiments.session.runs import load_runs
from experiments.workflows.fit import fit_runs
from tests.support.fits import document_of, synthetic_fit
from tests.support.imported_files import table
from tests.support.paths import FIXTURES
from tests.support.prescribed import ARM_RIG, arm_run, negated, written

VOLTS = '[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n'


def three_and_a_stuck_one() -> list[Dataset]:
    *runs, bad = (arm_run(k, seconds=6.0) for k in (0, 1, 2, 7))
    return [*runs, replace(bad, name="bad.csv", columns={**bad.columns, "q2_rad": np.full(len(bad), 0.3)})]


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
