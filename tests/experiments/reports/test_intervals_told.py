"""What a budget, runs that disagree and a second estimator say of a fit: first line, text, JSON, page, MODEL.json."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import InputError, parse_rig
from estimator import FitResult, RunAgreement
from estimator.fitting import next_measurement
from estimator.methods import ResultMethod
from estimator.model import leg2
from estimator.result import Budget, BudgetPart, HeldOut, SecondOpinion
from experiments.judge import Trust, fit_trust, model_of, with_fit_trust
from experiments.models import MechanismSettings, fitted_model_of, load_model, save_model
from experiments.rig import RigFacts
from experiments.rig.writer import rig_toml
from experiments.session.setup import stated_tolerances
from tests.support.fits import document_of, page_of, synthetic_fit, text_of
from tests.support.shell import read_json

SETTINGS = MechanismSettings(model="leg2", actuated=(2,), gravity_mps2=9.81)


def budgeted(enlarged: float = 1.0) -> FitResult:
    """A fit whose torque constant is known to 2 % and whose lever arm moves every parameter by half a per cent."""
    plain = synthetic_fit()
    parts = (BudgetPart("noise", np.diag(plain.std)),
             BudgetPart("torque_gain", 0.02 * plain.beta[None, :], (0.02,)),
             BudgetPart("imu_lever_arm", 0.005 * plain.beta[None, :], (0.002,)),
             BudgetPart("structure", 0.001 * np.diag(plain.beta)))
    budget = Budget(parts, np.zeros(plain.mechanism.p), {} if enlarged == 1.0 else {"IMU": enlarged})
    return replace(plain, budget=budget, covariance=np.sum([part.covariance for part in parts], axis=0))


def with_part(name: str, share: float) -> FitResult:
    """The same, of which another tolerance moves every parameter by this share."""
    found = budgeted()
    assert found.budget is not None
    wide = BudgetPart(name, share * found.beta[None, :], (0.1,))
    return replace(found, budget=replace(found.budget, parts=(*found.budget.parts, wide)),
                   covariance=found.covariance + wide.covariance)


def test_the_first_lines_say_how_well_a_parameter_is_known() -> None:
    trust = fit_trust(budgeted())
    assert trust.level == "good"
    assert trust.reasons[0] == "beta1 is known to 4.6 % (torque constant 3.9 %, noise 2.1 %, lever arm 0.98 %)."
    advice = next_measurement(budgeted())
    assert advice.source and advice.name == "torque_gain"
    assert "Write torque_gain = 0.002 under [tolerance]" in text_of(budgeted())


def test_json_page_and_model_have_the_parts(tmp_path: Path) -> None:
    found = budgeted(6.0)
    document = document_of(found).document
    row = document["budget"][0]
    assert row["parameter"] == "beta1" and row["parts"][0]["source"] == "torque_gain"
    assert sum(part["std"] ** 2 for part in row["parts"]) == pytest.approx(found.std[0] ** 2)
    assert document["tolerances_enlarged"] == {"IMU": 6.0}
    assert "the runs ask for larger tolerances: IMU 6 times" in text_of(found)
    page = page_of(found)
    assert "What the intervals consist of" in page and "share of the variance" in page
    save_model(model_of(found, SETTINGS, "linear", ["r1"]), tmp_path / "m.json")
    model = load_model(tmp_path / "m.json")
    whole = np.sum([np.array(part.directions).T @ np.array(part.directions) for part in model.budget], axis=0)
    assert whole == pytest.approx(np.array(model.covariance, dtype=float))
    band = fitted_model_of(model).covariance  # the torque of a run has the same scale as the parameters
    assert band is not None and band[0, 0] == pytest.approx(found.std[0] ** 2 - (0.02 * found.beta[0]) ** 2)
    wrong = read_json(tmp_path / "m.json")
    wrong["budget"][0]["directions"][0].pop()
    (tmp_path / "m.json").write_text(json.dumps(wrong))
    with pytest.raises(InputError, match="budget"):
        load_model(tmp_path / "m.json")


def test_a_value_that_the_budget_leaves_unknown_is_not_trusted() -> None:
    trust = fit_trust(with_part("imu_misalignment", 0.6))
    assert trust.level == "bad" and trust.sentence.startswith("DO NOT TRUST the parameters: the budget is wider")


def test_a_validation_repeats_what_the_fit_said_of_its_parameters() -> None:
    free_run = Trust("good", "TRUST for simulation over 5 s: fit 97 % at worst, q2 in r1.")
    bad = model_of(replace(budgeted(), prior_conflict=9.0), SETTINGS, "linear", ["r1"]).trust
    assert bad is not None and bad.level == "bad"
    told = with_fit_trust(free_run, bad)
    assert (told.level, told.sentence) == (
        "caution", "TRUST for simulation over 5 s, not the parameters: fit 97 % at worst, q2 in r1.")
    assert told.reasons == ("The fit did not trust the parameters: the runs contradict [prior].",)
    assert with_fit_trust(Trust("bad", "DO NOT TRUST: it is off."), bad).sentence == "DO NOT TRUST: it is off."
    assert with_fit_trust(free_run, model_of(budgeted(), SETTINGS, "linear", ["r1"]).trust) == free_run


LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[tolerance]\n'


def test_tolerances_of_a_rig_file() -> None:
    rig = parse_rig(LEG + "torque_gain = 0.01\njoint_stiffness.2 = [0.05, 0.01]\n")
    assert stated_tolerances(rig, leg2()) == {"torque_gain": (0.01,), "joint_stiffness@2": (0.05, 0.01)}
    assert stated_tolerances(parse_rig(LEG + "none = true\n"), leg2()) is None
    weighed = parse_rig("[calibration]\ntorque_constant_nm_per_a = 0.5\ntorque_constant_half_nm_per_a = 0.0098\n" + LEG)
    assert weighed.tolerances["torque_gain"] == pytest.approx((0.01,))


@pytest.mark.parametrize(("entry", "told"), [
    ("gyro_scale = -0.1", "from zero up"), ("none = 0.1", "none = true"), ("gyro_scale = true", "standard deviation"),
    ("gyro_scale = nan", "from zero up")])
def test_a_tolerance_that_is_none_is_refused(entry: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        parse_rig(LEG + entry)


@pytest.mark.parametrize("entry", ["gyro_scal = 0.1", "joint_stiffness.3 = 0.1"])
def test_a_tolerance_of_nothing_is_refused(entry: str) -> None:
    with pytest.raises(InputError, match="is no effect of this rig"):
        stated_tolerances(parse_rig(LEG + entry), leg2())


def test_init_writes_every_default_as_a_comment_that_can_be_taken_in() -> None:
    text = rig_toml(RigFacts(records=False))
    lines = [line.removeprefix("# ") for line in text.split("[tolerance]")[1].splitlines()[3:] if " = " in line]
    assert stated_tolerances(parse_rig(LEG + "\n".join(lines)), leg2()) is not None
    assert len(lines) > 20 and "torque_gain = 0.05" in lines[0]


def test_a_value_that_is_not_known_has_no_share_above_the_whole() -> None:
    line = document_of(with_part("encoder_offset@1", 14.0)).precision
    assert line.startswith("beta1 is not known: its interval is wider than its value")
    assert "%" not in line


RUNS = ("a.csv", "b.csv", "c.csv")


def with_runs(**more: Any) -> FitResult:
    plain = synthetic_fit()
    return replace(plain, agreement=RunAgreement(**{"runs": RUNS, "p_value": 0.3, "own_std": plain.std, **more}))


@pytest.fixture
def disputed() -> FitResult:
    """The knee's Coulomb level is another in the third run."""
    plain = synthetic_fit()
    by_run = np.tile(plain.beta, (3, 1))
    by_run[:, 8] = 0.10, 0.11, 0.14
    seen = np.arange(plain.mechanism.p) == 8
    return with_runs(p_value=2e-5, disagree=True, quantile=np.where(seen, 4.303, 1.959964), mean=by_run.mean(axis=0),
                     scatter=np.where(seen, 0.021, 1e-6), by_run=by_run, seen=seen)


def test_one_line_about_all_and_one_for_each_parameter(disputed: FitResult) -> None:
    text = text_of(disputed)
    assert ("3 runs disagree by more than their noise (p = 2e-05): intervals allow for it, 2.2 times as wide as by "
            "noise alone\nruns disagree about beta9 (Coulomb friction, knee): 0.100 .. 0.140, scatter 0.021 about "
            "0.117; interval widened 2.2 times") in text
    low, high = disputed.ci95()[8]
    assert high - low == pytest.approx(2 * 4.303 * disputed.std[8])


def test_runs_that_agree_and_one_alone_say_so() -> None:
    assert "3 runs agree within their noise (p = 0.3)" in text_of(with_runs())
    assert "one run gives no scatter between runs" in text_of(with_runs(p_value=None, runs=RUNS[:1]))
    assert "runs" not in text_of(synthetic_fit()).replace("ran ", "")


def test_the_json_says_what_each_run_says(disputed: FitResult) -> None:
    found = document_of(disputed).document["agreement"]
    assert found["runs"] == list(RUNS) and found["disagree"] and found["p_value"] == 2e-5
    knee = found["parameters"][8]
    assert knee["name"] == "beta9" and knee["by_run"] == [0.10, 0.11, 0.14] and knee["seen"]
    assert knee["widened"] == pytest.approx(4.303 / 1.959964)
    given = replace(disputed, fixed={"beta9": 0.1})
    assert "beta9" not in [p["name"] for p in document_of(given).document["agreement"]["parameters"]]
    assert document_of(with_runs()).document["agreement"]["parameters"] == []
    assert document_of(synthetic_fit()).document["agreement"] is None


def test_the_page_has_a_column_for_each_run(disputed: FitResult) -> None:
    page = page_of(disputed)
    assert "Do the runs agree?" in page and all(run in page for run in RUNS)
    assert "Do the runs agree?" not in page_of(synthetic_fit())


def test_the_first_line_is_careful_where_runs_disagree(disputed: FitResult) -> None:
    assert fit_trust(with_runs()).level == "good"
    trust = fit_trust(disputed)
    assert trust.level == "good" and "Runs disagree about beta9; the intervals allow for it." in trust.reasons


def with_opinion(times: float, held_out: HeldOut | None = None, reported: ResultMethod = "mle") -> FitResult:
    """A fit whose beta2 lies so many half widths from another method's; beta9 is not compared."""
    plain = synthetic_fit()
    half = 1.5 * plain.half_width
    apart = np.zeros(plain.mechanism.p)
    apart[1], apart[8] = times, np.nan
    other = plain.beta.copy()
    other[1] += times * np.hypot(half[1], plain.half_width[1])
    method: ResultMethod = "shooting" if reported == "mle" else "mle"
    return replace(plain, method=reported, second_opinion=SecondOpinion(method, other, half, apart, held_out))


def test_estimators_that_agree_take_a_line_and_no_warning() -> None:
    found = with_opinion(1.23)
    assert fit_trust(found).sentence == fit_trust(replace(found, second_opinion=None)).sentence
    assert ("second opinion, by multiple shooting: largest disagreement 1.2 half widths, in beta2; not compared: beta9"
            in text_of(found).splitlines())


@pytest.mark.parametrize(("held_out", "told"), [
    (None, "too little data to let held-out data decide"),
    (HeldOut(0.1, (-0.2, 0.3), 40), "held-out seconds do not decide (shooting's error is 10 % lower [-20, 30])"),
    (HeldOut(-0.5, (-0.7, -0.3), 40), "shooting's error on held-out seconds is 50 % higher [30, 70]")])
def test_the_first_line_says_that_mle_is_contradicted(held_out: HeldOut | None, told: str) -> None:
    trust = fit_trust(with_opinion(4.5, held_out))
    assert trust.level == "bad"
    assert trust.sentence == "DO NOT TRUST the parameters: two estimators disagree."
    assert trust.reasons[0].startswith("Two estimators disagree: beta2 is ")
    assert "4.5 half widths apart" in trust.reasons[0] and told in trust.reasons[0]


def test_the_first_line_says_that_shooting_is_reported() -> None:
    found = with_opinion(36.0, HeldOut(0.6, (0.4, 0.7), 40), "shooting")
    trust = fit_trust(found)
    assert (trust.level, trust.sentence) == ("bad", "DO NOT TRUST the parameters: two estimators disagree.")
    assert trust.reasons[0].startswith("Two estimators disagree: beta2 is ")
    assert "by maximum likelihood, 36.0 half widths apart" in trust.reasons[0]
    assert trust.reasons[0].endswith("shooting is reported, its error on held-out seconds is 60 % lower [40, 70].")


def test_json_and_page_have_both_estimates() -> None:
    found = with_opinion(36.0, HeldOut(0.6, (0.4, 0.7), 40), "shooting")
    document = document_of(found).document
    opinion = document["second_opinion"]
    assert (document["method"], opinion["method"], opinion["reported"]) == ("shooting", "mle", "shooting")
    assert opinion["disagreement"] == 36.0 and opinion["not_compared"] == ["beta9"]
    assert opinion["held_out"] == {"gain": 0.6, "ci95": [0.4, 0.7], "segments": 40}
    row = opinion["parameters"][1]
    assert row["name"] == "beta2" and row["disagreement"] == 36.0 and len(opinion["parameters"]) == 8
    assert found.second_opinion is not None and row["value"] == found.second_opinion.beta[1]
    assert document_of(synthetic_fit()).document["second_opinion"] is None
    page = page_of(found)
    assert "Second opinion" in page and "maximum likelihood" in page
