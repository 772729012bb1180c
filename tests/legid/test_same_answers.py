"""The shell and Python give the same JSON on the same files: every verb, bad runs among them."""

import csv
import gzip
import io
import json
import shutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from daq.runs import read_run
from daq.runs.csv_run import write_csv
from estimator import Method
from experiments import cli
from tests.support.paths import FIXTURES, REAL, ROOT, needs_records

RIGS = ROOT / "studies/rigs"
OF_THE_CALL = ("provenance", "wall_s")
"""What belongs to the call and not to its answer: the command line, the time it took."""
QUICK = ("healthy", "gap")
SLOWER = ("noisy", "clock-reset", "pulled-cable", "saturated-gyro")


@dataclass(frozen=True)
class Case:
    """Runs of one rig."""

    name: str
    rig: Path
    runs: tuple[Path, ...]
    method: Method = "mle"
    fixed: tuple[tuple[str, float], ...] = ()
    aside: tuple[str, ...] = ()
    """Bad runs among them."""


def fixture(name: str) -> Case:
    return Case(name, FIXTURES / "rig.toml", (FIXTURES / f"{name}.mcap",))


FIXTURE_CASES = {name: fixture(name) for name in (*QUICK, *SLOWER)}


def with_recorded_rig(case: Case, folder: Path) -> Case:
    """`case` with the rig file that its recording holds: the bias of its gyro is no other recording's."""
    rig = folder / f"{case.name}.toml"
    rig.write_text(read_run(case.runs[0]).files["rig.toml"])
    return replace(case, rig=rig)


def records() -> dict[str, Case]:
    """Of public records; the bad run of the arm is made by `case_of`."""
    c0, bam = REAL / "dfki_c0", REAL / "bam_xl330"
    servo = tuple(sorted(bam.glob("kp*.csv.gz")))[:4]
    return {"axis": Case("axis", RIGS / "emps.toml", (REAL / "emps/estimation.csv.gz",), "wls"),
            "pendulum": Case("pendulum", RIGS / "multiarm.toml", (REAL / "multiarm/free_swing.csv.gz",), "wls",
                             (("beta5", 0.01607),)),
            "servo": Case("servo", RIGS / "bam_xl330.toml", servo, "wls"),
            "arm": Case("arm", RIGS / "dfki_first.toml", tuple(c0 / f"{k}.csv.gz" for k in ("00", "01", "02", "05")),
                        "wls", aside=("bad.csv.gz",))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("same")


def with_bad_run(case: Case, folder: Path) -> Case:
    """`case` with a copy of its first run whose driven joint's encoder is stuck."""
    rows = list(csv.reader(io.StringIO(gzip.decompress(case.runs[0].read_bytes()).decode())))
    at = rows[0].index("q2_rad")
    bad = folder / "bad.csv.gz"
    lines = [rows[0], *([*row[:at], "0.3", *row[at + 1:]] for row in rows[1:])]
    bad.write_bytes(gzip.compress("\n".join(",".join(row) for row in lines).encode()))
    return Case(case.name, case.rig, (*case.runs[:2], bad, *case.runs[2:]), case.method, case.fixed, case.aside)


def leg_with_bad_run(folder: Path) -> Case:
    """A fixture, and the same again with its knee's encoder stuck."""
    target = folder / "stuck"
    target.mkdir(exist_ok=True)
    rig = FIXTURES / "rig.toml"
    write_csv(legid.load(FIXTURES / "healthy.mcap", rig), target / "healthy.csv")
    run = legid.load(target / "healthy.csv", rig)
    stuck = dict(run.columns) | {"q2_rad": np.full(len(run), 0.3)}
    write_csv(legid.Dataset("bad.csv", run.rate_hz, run.time_s, stuck), target / "bad.csv")
    return Case("leg", rig, tuple(target / f"{name}.csv" for name in ("healthy", "bad")), "wls",
                aside=("bad.csv",))


def answer(path: Path) -> Any:
    """A document without what belongs to the call, the fits of `--each` one by one."""
    def less(part: Any) -> Any:
        return {k: v for k, v in part.items() if k not in OF_THE_CALL} if isinstance(part, dict) else part

    found = less(json.loads(path.read_text()))
    return found | {"fits": [less(fit) for fit in found["fits"]]} if "fits" in found else found


def shell(folder: Path, *words: object) -> Any:
    out = folder / f"{abs(hash(words))}.json"
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        status = cli.main([*map(str, words), "--json", str(out), "--force"])
    assert status in (0, 1)
    return answer(out)


def python(folder: Path, result: Any) -> Any:
    out = folder / "python.json"
    out.unlink(missing_ok=True)
    result.to_json(out)
    return answer(out)


def fixes(case: Case) -> list[str]:
    return [word for name, value in case.fixed for word in ("--fix", f"{name}={value}")]


def same_fit(case: Case, folder: Path) -> None:
    said = shell(folder, "fit", *case.runs, "--rig", case.rig, "--method", case.method, "--damaged", *fixes(case))
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)
    each = shell(folder, "fit", "--each", *case.runs[:2], "--rig", case.rig, "--method", case.method, "--damaged",
                 "--workers", 1, *fixes(case))
    for path, one in zip(case.runs[:2], each["fits"], strict=True):
        assert one.pop("run") == str(path.resolve())
        try:
            alone = legid.fit(legid.load(path, case.rig, damaged=True), case.rig, case.method, fixed=dict(case.fixed))
        except legid.FitError as error:
            assert one["error"] == str(error)
            continue
        assert python(folder, alone) == one


def models_of(case: Case, folder: Path) -> tuple[Path, Path]:
    """Two models of the rig, the second with one parameter larger."""
    first, second = folder / f"{case.name}-a.json", folder / f"{case.name}-b.json"
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        assert cli.main(["fit", *map(str, case.runs), "--rig", str(case.rig), "--method", case.method, "--damaged",
                         *fixes(case), "--model-out", str(first), "--force"]) == 0
    document = json.loads(first.read_text())
    document["parameters"][0]["value"] *= 1.1
    second.write_text(json.dumps(document))
    return first, second


def same_validation(case: Case, folder: Path) -> None:
    first, second = models_of(case, folder)
    said = shell(folder, "validate", first, *case.runs, "--rig", case.rig, "--damaged")
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)
    said = shell(folder, "validate", first, *case.runs, "--rig", case.rig, "--damaged", "--against", second,
                 "--horizons", "0.2,0.4")
    assert [row["horizon_s"] for row in said["horizons"][:2]] == [0.2, 0.4] and "against" in said["horizons"][0]
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)


def same_comparison(case: Case, folder: Path) -> None:
    first, second = models_of(case, folder)
    said = shell(folder, "compare", first, second, *case.runs, "--rig", case.rig, "--damaged")
    runs = legid.load(case.runs, case.rig, damaged=True)
    with pytest.raises(legid.InputError, match="horizons_s"):
        legid.compare(legid.load_model(first), legid.load_model(second), runs, horizons_s=(0.0,))
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)


def same_diagnosis(case: Case, folder: Path) -> None:
    said = shell(folder, "diagnose", *case.runs, "--rig", case.rig, "--damaged", "--workers", 1, *fixes(case))
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)


def same_tuning(case: Case, folder: Path) -> None:
    said = shell(folder, "tune", *case.runs, "--rig", case.rig, "--damaged")
    assert [run["run"] for run in said["set_aside"]] == list(case.aside)


VERBS: dict[str, Callable[[Case, Path], None]] = {
    "fit": same_fit, "validate": same_validation, "compare": same_comparison, "diagnose": same_diagnosis,
    "tune": same_tuning}
SHORT, LONG = ("fit", "validate", "compare"), ("diagnose", "tune")
"""Verbs by whether they answer on a public record within a minute."""


@pytest.mark.parametrize("name", QUICK)
def test_a_fit_of_a_fixture(name: str, folder: Path) -> None:
    same_fit(FIXTURE_CASES[name], folder)


@pytest.mark.parametrize("verb", [*SHORT, *(pytest.param(verb, marks=pytest.mark.slow) for verb in LONG)])
def test_a_verb_on_runs_of_which_one_is_bad(verb: str, folder: Path) -> None:
    VERBS[verb](leg_with_bad_run(folder), folder)


@pytest.mark.parametrize("verb", [pytest.param(verb, marks=pytest.mark.slow if verb in SHORT else pytest.mark.study)
                                  for verb in (*SHORT, *LONG)])
@pytest.mark.parametrize("name", FIXTURE_CASES)
def test_every_verb_on_every_fixture(name: str, verb: str, folder: Path) -> None:
    VERBS[verb](with_recorded_rig(FIXTURE_CASES[name], folder), folder)


@needs_records
@pytest.mark.parametrize("verb", [pytest.param(verb, marks=pytest.mark.slow if verb in SHORT else pytest.mark.study)
                                  for verb in (*SHORT, *LONG)])
@pytest.mark.parametrize("name", ["axis", "pendulum", "servo", "arm"])
def test_every_verb_on_public_records(name: str, verb: str, folder: Path) -> None:
    case = records()[name]
    VERBS[verb](with_bad_run(case, folder) if case.aside else case, folder)


def test_validate_compare_and_python_tell_one_error_of_a_model_on_runs(folder: Path) -> None:
    """By horizon and sensor to the last digit; a whole run's is that of its segment, but for the order of a sum."""
    case = FIXTURE_CASES["healthy"]
    first, second = models_of(case, folder)
    words = [*case.runs, "--rig", case.rig, "--horizons", "0.2,1"]
    validated = [{row["horizon_s"]: row["rmse"] for row in shell(folder, "validate", model, *words)["horizons"]}
                 for model in (first, second)]
    compared = shell(folder, "compare", first, second, *words)["errors"]
    rows = [row for row in compared if row["column"] != "gyro_radps" and row["horizon_s"] is not None]
    assert {row["horizon_s"] for row in rows} == {0.2, 1.0}
    for row in rows:
        assert [validated[k][row["horizon_s"]][row["column"]] for k in (0, 1)] == [row["a"], row["b"]]
    (alone,) = legid.validate(legid.load_model(first), legid.load(case.runs[0]))
    whole = {row["column"]: row["a"] for row in compared if row["horizon_s"] is None and row["column"] in alone.rmse}
    assert set(whole) == {"q1_rad", "q2_rad"}
    assert whole == pytest.approx({name: alone.rmse[name] for name in whole}, rel=1e-12)
    assert alone.rmse["q1_rad"] != pytest.approx(alone.rmse["q2_rad"], rel=0.01)


def test_a_model_and_runs_are_not_compared(folder: Path) -> None:
    run = legid.load(FIXTURE_CASES["healthy"].runs)
    with pytest.raises(legid.InputError, match="was given a model and runs"):
        legid.compare(run, legid.load_model(models_of(FIXTURE_CASES["healthy"], folder)[0]))  # type: ignore[call-overload]


def test_gains_effects_and_an_import(folder: Path) -> None:
    model, _ = models_of(FIXTURE_CASES["healthy"], folder)
    assert python(folder, legid.gains(legid.load_model(model), angle_rad=0.1)) == shell(
        folder, "gains", model, "--angle", 0.1)
    assert python(folder, legid.effects()) == shell(folder, "effects")
    (folder / "theirs").mkdir()
    theirs, columns = folder / "theirs/log.csv", folder / "columns.toml"
    shutil.copy(export_of("healthy", folder), theirs)
    columns.write_text('[columns.q2_rad]\nname = "q2_rad"\n[columns.tau2_nm]\nname = "tau2_nm"\nsign = -1\n')
    out = folder / "imported"
    with redirect_stdout(io.StringIO()):
        assert cli.main(["import", str(theirs), "--map", str(columns), "--out", str(out)]) == 0
    again = folder / "again.csv"
    write_csv(legid.read(theirs, columns), again)
    assert again.read_bytes() == (out / "log.csv").read_bytes()
    same = legid.read(theirs, {"q2_rad": {"name": "q2_rad"}, "tau2_nm": {"name": "tau2_nm", "sign": -1}})
    assert all(np.array_equal(same[name], legid.read(theirs, columns)[name], equal_nan=True) for name in same.columns)


def export_of(name: str, folder: Path) -> Path:
    path = folder / f"{name}.csv"
    write_csv(legid.load(FIXTURES / f"{name}.mcap"), path)
    return path


def test_a_plan(folder: Path) -> None:
    model, _ = models_of(FIXTURE_CASES["healthy"], folder)
    rig = FIXTURES / "rig.toml"
    plain = ["excite", "--rig", str(rig), "--seconds", "6", "--force", "--out"]
    shown, written = folder / "shell.csv", folder / "python.csv"
    for words, found in (([], legid.excite(rig, seconds=6.0)), (
            ["--model", str(model), "--tries", "1", "--steps", "1"],
            legid.excite(rig, legid.load_model(model), seconds=6.0, tries=1, steps=1))):
        with redirect_stdout(io.StringIO()):
            assert cli.main([*plain, str(shown), *words]) == 0
        legid.write_plan(found.plan, written)
        assert written.read_bytes() == shown.read_bytes()
        assert len(found.to_frame()) == (9 if words else 600) and len(found.plot().axes) == 1
