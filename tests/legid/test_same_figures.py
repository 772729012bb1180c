"""Commands give equal figures about the same thing: the free-run errors of a model on a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import legid
from daq.runs import write_csv
from estimator.prediction import HORIZONS_S
from experiments.documents import finite
from experiments.judge import diagnosed_model
from tests.support.mujoco_leg import Leg, record
from tests.support.paths import FIXTURES
from tests.support.runs import without

STIFFNESS = 0.8
SAME = 1e-9


@pytest.fixture(scope="module")
def runs(module_path: Path) -> list[legid.Dataset]:
    """Of a leg with a spring at its pivot, whose angle no encoder reads."""
    rig = module_path / "rig.toml"
    rig.write_text('[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = 0.2\n'
                   '[sampling]\nhold = "linear"\n[noise]\ngyro_radps = 0.005\n')
    for k in range(4):
        run = record(Leg(), 700 + k, seconds=10.0, name=f"r{k}.csv", spring=(STIFFNESS, 0.2))
        write_csv(without(run, "q1_rad"), module_path / run.name)
    return [legid.load(module_path / f"r{k}.csv", rig) for k in range(4)]


@pytest.fixture(scope="module")
def found(runs: list[legid.Dataset]) -> legid.Diagnosis:
    return legid.diagnose(runs, seed=1)


def test_a_stiff_pivot_is_named_with_its_size(found: legid.Diagnosis, runs: list[legid.Dataset]) -> None:
    assert found.verdict in ("named", "one_of"), found.sentence
    causes = {(c.effect, c.joint): c for c in found.causes}
    assert ("joint_stiffness", 1) in causes, found.sentence
    assert causes[("joint_stiffness", 1)].size[0].value == pytest.approx(STIFFNESS, rel=0.25)
    assert found.gap_closed is not None and found.gap_closed > 0.8
    knee = np.concatenate([run["q2_rad"] for run in runs if run.name not in found.confirm_runs])
    assert found.details.angle_range[1] == pytest.approx((knee.min(), knee.max()), abs=3e-3)


def test_diagnose_validate_and_compare_give_equal_errors(found: legid.Diagnosis, runs: list[legid.Dataset],
                                                         tmp_path: Path) -> None:
    models = []
    for name, one in (("nominal", replace(found.details, effects=())), ("extended", found.details)):
        legid.save_model(diagnosed_model(one, found.prepared.setup, 1.0), tmp_path / f"{name}.json")
        models.append(legid.load_model(tmp_path / f"{name}.json"))
    nominal, extended = models
    tests = [run for run in runs if run.name in found.confirm_runs]
    errors = legid.compare(nominal, extended, tests).errors
    both, alone = legid.validate(extended, tests, against=nominal), legid.validate(nominal, tests)
    knee = [(e.a, e.b) for e in errors if e.column == "q2_rad"]
    rows = list(zip(alone.horizons, both.horizons, strict=True))
    assert len(rows) == len(HORIZONS_S)
    for (before, after), (first, row) in zip(knee, rows, strict=True):
        assert (first.rmse["q2_rad"], row.rmse["q2_rad"]) == pytest.approx((before, after), rel=SAME)
        assert row.against and row.against.rmse["q2_rad"] == pytest.approx(before, rel=SAME)
    whole = {e.column: (finite(e.a), finite(e.b)) for e in errors if e.horizon_s is None}
    assert {"q2_rad", "gyro_radps"} == set(whole) and whole["q2_rad"][0] > 2.0 * whole["q2_rad"][1]
    told = found.document["gain"]["free_run_rmse"]
    for column, (before, after) in whole.items():
        assert (told[column]["before"], told[column]["after"]) == pytest.approx((before, after), rel=SAME), column
    # no sensor reads the pivot: both simulations are compared with the motion of the extended model
    assert row.against
    pivot = (row.against.rmse["q1_rad"], row.rmse["q1_rad"])
    assert (told["q1_rad"]["before"], told["q1_rad"]["after"]) == pytest.approx(pivot, rel=SAME)
    assert both[0].rmse["q2_rad"] == pytest.approx(told["q2_rad"]["after"], rel=SAME)


def test_validate_and_compare_tell_one_error_of_a_model_on_a_run() -> None:
    """By horizon and sensor to the last digit; a whole run's is that of its segment, but for the order of a sum."""
    run = legid.load(FIXTURES / "healthy.mcap", FIXTURES / "rig.toml")
    fit = legid.fit(run, method="wls")
    other = legid.fit(run, method="wls", fixed={"beta1": 1.1 * float(fit.beta[0])})
    models = legid.model(fit), legid.model(other)
    horizons = (0.2, 1.0)
    seen = [legid.validate(model, run, horizons_s=horizons) for model in models]
    errors = legid.compare(*models, run, horizons_s=horizons).errors
    rows = [row for row in errors if row.column != "gyro_radps" and row.horizon_s is not None]
    assert {row.horizon_s for row in rows} == set(horizons)
    told = [{row.horizon_s: row.rmse for row in one.horizons} for one in seen]
    assert all([one[row.horizon_s or 0.0][row.column] for one in told] == [row.a, row.b] for row in rows)
    (alone,) = seen[0]
    whole = {row.column: row.a for row in errors if row.horizon_s is None and row.column in alone.rmse}
    assert set(whole) == {"q1_rad", "q2_rad"}
    assert whole == pytest.approx({name: alone.rmse[name] for name in whole}, rel=1e-12)
    assert alone.rmse["q1_rad"] != pytest.approx(alone.rmse["q2_rad"], rel=0.01)
    with pytest.raises(legid.InputError, match="horizons_s"):
        legid.compare(*models, run, horizons_s=(0.0,))
    with pytest.raises(legid.InputError, match="was given a model and runs"):
        legid.compare([run], models[0])  # type: ignore[call-overload]
