"""`make blind`: the runner, the baselines and the page, on two small cases."""

from __future__ import annotations

import datetime
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.evidence.blind import baselines, page, run
from tests.evidence.blind.cases import Case, draw_case
from tests.evidence.blind.effects import INSIDE, START
from tests.evidence.blind.leg import Leg
from tests.evidence.blind.measure import imu
from tests.evidence.blind.physics import integrate
from tests.evidence.blind.score import Rate

pytestmark = pytest.mark.slow

CASES = [Case("none", seed=2), Case("deleted", ("torque_offset",), "large", 1)]
NAMED = {"verdict": "named", "causes": [{"effect": "torque_offset", "joint": None, "size": []}],
         "gain": {"gap_closed": 0.9}, "bench": {"status": 0, "wall_s": 30.0, "crashed": False, "said": ""}}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("bench")
    run.make_cases(CASES, root / "cases", lambda text: None, samples=400, step=2e-3)
    return root


def test_cases_are_listed_by_class_level_and_effect() -> None:
    assert [c.name for c in run.list_cases(["none"], [1000, 1001], ["small", "large"])] == ["none-1000", "none-1001"]
    chosen = run.list_cases(["single", "deleted"], [5], ["small", "large"], ["backlash"])
    assert [c.name for c in chosen] == ["single-backlash-small-5", "single-backlash-large-5",
                                        "deleted-backlash-small-5", "deleted-backlash-large-5"]
    assert all("backlash" in c.effects for c in run.list_cases(["pair"], range(60), effects=["backlash"]))
    assert len(run.list_cases(["single"], [5])) == len(INSIDE)
    assert run.parse_seeds("3,7-9") == [3, 7, 8, 9]


def test_a_deleted_effect_is_gone_from_the_command_s_library(tmp_path: Path) -> None:
    def effects(*command: str) -> list[str]:
        file = tmp_path / "effects.json"
        subprocess.run([*command, "effects", "--json", str(file)], check=True, capture_output=True)
        return [e["effect"] for e in json.loads(file.read_text())["effects"]]

    every = effects(*run.COMMAND)
    assert effects(sys.executable, "-c", run.WITHOUT, "backlash") == [e for e in every if e != "backlash"]
    wrong = subprocess.run([sys.executable, "-c", run.WITHOUT, "no_such", "effects"], capture_output=True, text=True)
    assert wrong.returncode == 1 and "no effect no_such" in wrong.stderr
    command = run.command_of(CASES[1], Path("c"), Path("a"), 2)
    assert command[-2:] == ["--workers", "2"]
    assert command[:4] == [sys.executable, "-c", run.WITHOUT, "torque_offset"]
    assert command[4] == "diagnose" and command.count("--rig") == 1


def test_a_bench_goes_on_where_it_stopped(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command is replaced by one that copies its arguments: what it costs to diagnose is not the matter here."""
    stub = ("import json,os,sys; json.dump({'verdict':'none','causes':[],'session':os.getsid(0)},"
            "open(sys.argv[sys.argv.index('--json')+1],'w'))")
    monkeypatch.setattr(run, "command_of", lambda case, cases, answer, share: [
        sys.executable, "-c", stub if case.kind == "none" else "raise SystemExit('broken')", "--json", str(answer)])
    said: list[str] = []
    run.run_cases(CASES, bench, workers=1, say=said.append)
    answers = {p.stem: json.loads(p.read_text()) for p in (bench / "diagnoses").iterdir()}
    assert set(answers) == {c.name for c in CASES}
    assert answers["none-2"]["verdict"] == "none" and answers["none-2"]["bench"]["status"] == 0
    assert answers["none-2"]["session"] != os.getsid(0), "an interrupt of the bench would reach the diagnosis"
    broken = answers[CASES[1].name]
    assert broken["verdict"] == "fit_failed" and broken["bench"]["crashed"] and broken["bench"]["said"] == "broken"
    before = {p: p.stat().st_mtime_ns for p in bench.rglob("*") if p.is_file()}
    run.make_cases(CASES, bench / "cases", said.append)
    run.run_cases(CASES, bench, say=said.append)
    assert said[-1] == "2 of 2 cases are diagnosed already"
    assert {p: p.stat().st_mtime_ns for p in bench.rglob("*") if p.is_file()} == before


def test_a_diagnosis_past_its_limit_is_recorded(bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "command_of", lambda *_: [sys.executable, "-c", "import time; time.sleep(60)"])
    found = run.diagnose(CASES[0], bench / "cases", tmp_path, limit_s=0.5)
    assert found["verdict"] == "fit_failed" and found["bench"]["crashed"] and "not done" in found["bench"]["said"]


def test_the_command_s_own_refusal_is_recorded(bench: Path, tmp_path: Path) -> None:
    """The real command, on runs that are not there."""
    found = run.diagnose(Case("none", seed=77), bench / "cases", tmp_path)
    assert found["bench"]["status"] == 2 and found["bench"]["said"].startswith("legid diagnose: ")
    assert json.loads((tmp_path / "none-77.json").read_text()) == found


def _records(leg: Leg, extra: dict[str, float], numbers: range, seconds: float) -> list[baselines.Record]:
    """Noise-free readings of the bench's physics, which its own tests hold against MuJoCo."""
    grid = np.arange(round(100 * seconds)) / 100
    case = draw_case(Case("none", seed=4), START)
    tau = np.array([case.torques[k].at(grid, 0.6) for k in numbers]).T
    motion = integrate(leg, tau, step=1e-3, extra={k: np.full(tau.shape[1], v) for k, v in extra.items()})
    still = np.zeros(grid.size)
    found = []
    for lane, k in enumerate(numbers):
        gyro, ax, ay = imu(motion.q1[:, lane], motion.w1[:, lane], motion.a1[:, lane], still, still, 0.2)
        found.append(baselines.Record(motion.q2[:, lane], tau[:, lane], gyro, ax, ay, 0.2, 50.0, k))
    return found


def test_baselines_regress_on_the_leg_s_equations() -> None:
    leg = Leg(coulomb1=0.0, coulomb2=0.0)
    [record] = _records(leg, {}, range(1), 10.0)
    rest = baselines._thin(baselines.need(record, np.asarray(leg.beta(), float)))
    # what is left of a peak of 0.6 N m is the filters' and the integrated gyro's
    assert np.sqrt(np.mean(rest**2)) < 0.01
    wrong = baselines._thin(baselines.need(record, np.asarray(Leg(m2=0.9).beta(), float)))
    assert np.sqrt(np.mean(wrong**2)) > 0.02


def test_baselines_find_an_effect_where_nothing_is_noisy() -> None:
    records = _records(Leg(), {"rotor": 0.02, "gear": 50.0}, range(8), 6.0)
    problem = baselines.build(records)
    assert problem.torque.shape == (problem.nominal.shape[0],) == problem.run.shape
    assert [k[0] for k in baselines.choose_bic(problem)] == ["rotor_inertia"]
    assert [k[0] for k in baselines.choose_heldout(problem)] == ["rotor_inertia"]
    gone = baselines.build(records, "rotor_inertia")
    assert len(gone.terms) == len(problem.terms) - 1
    assert [k[0] for k in baselines.choose_bic(gone)] != ["rotor_inertia"]


def test_baselines_know_every_effect_of_the_library(bench: Path) -> None:
    problem = baselines.build(baselines.read_case(bench / "cases" / "none-2"))
    assert {key[0] for key in problem.terms} == set(INSIDE)
    assert all(np.isfinite(columns).all() for columns in problem.terms.values())


def test_sparse_regression_keeps_what_is_there(bench: Path) -> None:
    pytest.importorskip("pysindy", reason="make blind installs it")
    plain = baselines.build(baselines.read_case(bench / "cases" / "none-2"))
    noise = np.random.default_rng(0).normal(size=plain.torque.size)
    nothing = replace(plain, torque=plain.nominal @ np.ones(9) + noise)
    assert baselines.choose_stlsq(nothing) == []
    chosen = ("torque_ripple", 2, 2.0)
    some = replace(nothing, torque=nothing.torque + 40.0 * plain.terms[chosen][:, 0]
                   / np.std(plain.terms[chosen][:, 0]))
    assert chosen in baselines.choose_stlsq(some)


def test_sensible_answers() -> None:
    said = baselines.answer([("torque_ripple", 2, 1.0), ("torque_ripple", 2, 2.0)])
    assert said["verdict"] == "named" and [c["effect"] for c in said["causes"]] == ["torque_ripple"]
    assert baselines.answer([])["verdict"] == "none"


def test_a_target_is_met_missed_or_left_open() -> None:
    most, least = page.Target("x", 0.05, at_most=True), page.Target("x", 0.85)
    assert most.judge(Rate(0, 100)) == "met" and most.judge(Rate(0, 5)).startswith("met, but")
    assert most.judge(Rate(50, 100)) == "**missed**" and most.judge(Rate(1, 5)).startswith("**missed**, though")
    assert least.judge(Rate(100, 100)) == "met" and least.judge(Rate(10, 100)) == "**missed**"
    assert least.judge(Rate(0, 0)) == "not run"


def test_the_page_says_what_was_measured_and_missed(bench: Path, tmp_path: Path) -> None:
    for source in (bench / "cases").glob("*.truth.json"):
        (tmp_path / "cases").mkdir(exist_ok=True)
        (tmp_path / "cases" / source.name).write_text(source.read_text())
    truth = json.loads((tmp_path / "cases" / "deleted-torque_offset-large-1.truth.json").read_text())
    single = truth | {"name": "single-torque_offset-moderate-1000", "class": "single", "level": "moderate",
                      "seed": 1000, "ratio": {"projected": 3.0}}
    (tmp_path / "cases" / f"{single['name']}.truth.json").write_text(json.dumps(single))
    answers = {"none-2": NAMED, CASES[1].name: NAMED | {"verdict": "fit_failed", "causes": [], "bench": {
        "status": 1, "wall_s": 3.0, "crashed": True, "said": "ran off"}}, single["name"]: NAMED}
    for folder in ("diagnoses", *(f"baselines/{m}" for m in baselines.METHODS)):
        (tmp_path / folder).mkdir(parents=True)
        for name, answer in answers.items():
            (tmp_path / folder / f"{name}.json").write_text(json.dumps(answer))
    text = page.write_page(tmp_path, datetime.date(2026, 1, 2))
    lines = text.splitlines()
    assert lines[0] == "# Blind bench, 2026-01-02"
    assert "Seeds 1-2, 1000. Seeds 1-2 are for tuning" in text
    alarm = next(line for line in lines if line.startswith("| false alarms"))
    assert "1/1 = 100.0 %" in alarm and "**missed**" in alarm and "asks for 100 negatives" in alarm
    exact = next(line for line in lines if line.startswith("| moderate singles: named exactly"))
    assert "1/1" in exact and "met, but so few cases" in exact
    assert "| gap closed on confirm runs, median | 0.90 of 1 singles" in text
    assert "| pairs: both named | no cases | at least 60 % | not run |" in text
    assert "- deleted-torque_offset-large-1: ran off" in text
    assert "## Baselines on the same data\n\n3 cases." in text
    assert "| torque_offset (deleted) | 1 x fit_failed |" in text
    with pytest.raises(ValueError, match="no diagnosis"):
        page.write_page(tmp_path / "cases", datetime.date(2026, 1, 2))
