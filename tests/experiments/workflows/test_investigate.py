"""An investigation: what follows each verdict, how it ends, what it leaves; diagnoses are made up, one test is real."""

import json
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import legid
from daq import InputError, WorkError
from daq.recording import Plan, read_plan
from estimator.diagnosis import Diagnosis
from estimator.diagnosis.result import Cause, SizeEstimate
from experiments import cli
from experiments.emulation.plant import LegBody
from experiments.excite import Search
from experiments.judge import Investigation
from experiments.reports import diagnosis_figures, figures
from experiments.workflows import Asked, fit_runs, investigate, investigate_rig
from experiments.workflows.time_budget import Clock, End, Spent
from tests.support.diagnoses import NAMES, synthetic
from tests.support.pages import Outside
from tests.support.paths import DEMO_RIG as RIG

Answers = Iterator[Diagnosis | BaseException]


def cause(effect: str, joint: int | None, size: str, value: float) -> Cause:
    return Cause(effect, joint, effect, (SizeEstimate(size, "", value, (value, value)),), 0.0, 9.0, ())


DRAG, STRIBECK = cause("quadratic_drag", 2, "drag", 0.001), cause("stribeck_friction", 2, "excess_torque", 0.03)
LEG = replace(synthetic(), nominal=dict(zip(NAMES, LegBody().beta())), compared=((("quadratic_drag@2",), 1.1),))
RIVALS = replace(LEG, verdict="one_of", causes=(DRAG, STRIBECK))
NAMED = replace(LEG, causes=(DRAG,))
UNEXPLAINED = replace(LEG, verdict="unexplained", causes=())
OFFSET = replace(LEG, verdict="one_of", causes=(cause("torque_offset", None, "offset", 0.01),
                                                cause("asymmetric_friction", 2, "coulomb_difference", 0.02)))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch, demo_run: Path) -> Callable[..., list[str]]:
    """A function that makes recordings copies of one run, and diagnoses the given ones; its list has the run files."""

    def prepared(*answers: Diagnosis | BaseException, drawn: bool = False) -> list[str]:
        left, recorded = iter(answers), []

        def record(rig: Any, plan: Plan, out: Path, *more: Any) -> None:
            recorded.append(out.name)
            shutil.copy(demo_run, out)

        def diagnosed(*given: Any, progress: Callable[[str, float], None], **more: Any) -> Diagnosis:
            progress("fitting", 0.1)
            one = next(left)
            if isinstance(one, BaseException):
                raise one
            return one

        monkeypatch.setattr(investigate, "record_plan", record)
        monkeypatch.setattr(investigate, "diagnose_prepared", diagnosed)
        monkeypatch.setattr(investigate, "Search", lambda margin, tries, steps, seed: Search(margin, "d", 1, 2, seed))
        monkeypatch.setattr(investigate, "SECONDS", 4.0)
        monkeypatch.setattr("experiments.excite.separation.DRAWS", 1)
        if not drawn:  # a step redraws its pages; what these tests say is not in their pictures
            for module in (figures, diagnosis_figures):
                monkeypatch.setattr(module, "to_svg", lambda figure: "<svg></svg>")
        return recorded

    return prepared


def run(out: Path, asked: Asked | None = None, budget_s: float = 600.0) -> Investigation:
    from experiments.provenance import origin_of

    return investigate_rig(RIG, out, budget_s, asked or Asked(lambda what: True), origin_of)


def check_journal(out: Path, ending: str) -> dict[str, Any]:
    """The JSON of the journal; its page is whole and loads nothing."""
    found = json.loads((out / "investigation.json").read_text())
    page, outside = (out / "investigation.html").read_text(), Outside()
    outside.feed(page)
    assert found["schema"] == "legid.investigation/1" and found["ending"] == ending
    assert page.rstrip().endswith("</html>") and outside.found == [] and f"Next step: {found['next_step'][:12]}" in page
    return dict(found)


def test_rivals_are_separated_and_the_journal_says_what_was_believed(
        tmp_path: Path, made_up: Callable[..., list[str]]) -> None:
    recorded = made_up(RIVALS, NAMED, drawn=True)
    asked: list[str] = []
    done = run(tmp_path / "i", Asked(lambda what: not asked.append(what)))
    assert done.ending == "settled" and done.found is NAMED and len(asked) == len(recorded) == len(done.runs)
    found = check_journal(tmp_path / "i", "settled")
    first, second = found["steps"]
    assert first["before"] is None and first["after"]["verdict"] == second["before"]["verdict"] == "one_of"
    assert [one["kind"] for one in first["experiments"]][-4:] == ["large", "ramps", "small", "swing"]
    (separating,) = second["experiments"]
    assert separating["kind"] == "separate" and separating["expected"][0]["log_likelihood_ratio"] > 0.0
    assert second["before"]["compared"] == [{"explanation": "quadratic_drag@2", "error": 1.1}]
    assert "expected to settle them with 90 % probability" in separating["why"]
    assert found["diagnosed"] == recorded and "separate" in asked[-1]
    plan = read_plan(tmp_path / "i" / f"plan{len(recorded):02d}.csv")
    assert 0.0 < plan.peak_nm <= 0.8 * 2.0 and plan.duration_s == pytest.approx(separating["seconds"])
    with pytest.raises(InputError, match="holds runs of an earlier investigation"):
        run(tmp_path / "i")


def test_without_an_explanation_other_kinds_of_motion_follow_until_none_is_left(
        tmp_path: Path, made_up: Callable[..., list[str]]) -> None:
    made_up(*[UNEXPLAINED] * 20)
    done = run(tmp_path / "i")
    kinds = [one.kind for step in done.steps[1:] for one in step.experiments]
    assert done.ending == "exhausted" and "every kind of motion was recorded" in done.why
    assert len(kinds) == len(set(kinds)) and set(kinds) == {"slow", "steady", "fast", "micro", "rest"}
    assert all(one.seconds == pytest.approx(8.0, abs=0.1) for step in done.steps[1:] for one in step.experiments)
    check_journal(tmp_path / "i", "exhausted")


def test_runs_that_should_have_told_the_rivals_apart_end_it(tmp_path: Path, made_up: Callable[..., list[str]],
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    made_up(*[RIVALS] * 20)
    done = run(tmp_path / "i")
    assert done.ending == "exhausted" and "none of them is true as modelled" in done.why
    assert sum(one.kind == "separate" for step in done.steps for one in step.experiments) >= investigate.SETTLED_RUNS
    made_up(OFFSET)
    monkeypatch.setattr("experiments.excite.separation.LEAST", 1e9)  # no plan tells anything apart
    done = run(tmp_path / "j")
    assert done.ending == "exhausted" and "No torque within the limits tells asymmetric_friction@2 and" in done.why
    assert len(done.steps) == 1 and done.next_step == LEG.next_experiment


def test_ctrl_c_leaves_runs_diagnosis_and_journal_whole(tmp_path: Path, made_up: Callable[..., list[str]],
                                                        capsys: pytest.CaptureFixture[str]) -> None:
    recorded = made_up(RIVALS, KeyboardInterrupt())
    out = tmp_path / "i"
    assert cli.main(["investigate", "--rig", str(RIG), "--emulate", "--out", str(out), "--quiet"]) == 1
    assert capsys.readouterr().err == "legid investigate: interrupted\n"
    found = check_journal(out, "stopped")
    assert found["diagnosed"] == recorded[:-1] and [one["after"] is None for one in found["steps"]] == [False, True]
    assert all((out / name).is_file() for name in recorded)
    assert json.loads((out / "diagnosis1.json").read_text())["verdict"] == "one_of"
    assert found["next_step"].startswith("Diagnose with the runs that the answer lacks")


def test_a_step_that_cannot_end_in_time_is_not_begun(tmp_path: Path, made_up: Callable[..., list[str]],
                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = made_up(RIVALS, NAMED)
    monkeypatch.setattr(Clock, "require", lambda clock, needed, what: past(clock, needed, what))
    plain = Clock.expected_s

    def past(clock: Clock, needed_s: float, what: str) -> None:
        if what == "the next step":
            assert needed_s == pytest.approx(plain(clock, 4.0, 1, 4.0 * len(recorded), True), rel=0.05)
            raise End("budget", "no time is left.")

    done = run(tmp_path / "i")
    assert done.ending == "budget" and done.found is RIVALS and len(recorded) == len(done.runs) == len(done.diagnosed)
    assert done.next_step.startswith("Go on with a larger budget")
    with pytest.raises(InputError, match=r"--budget: 0\.1 min hold no first diagnosis"):
        run(tmp_path / "j", budget_s=6.0)
    assert not (tmp_path / "j").exists()


def test_the_clock_keeps_the_budget() -> None:
    clock = Clock(0.2)
    with pytest.raises(End, match=r"0\.0 min left, and a long step is expected to take 0\.1 min"):
        clock.require(6.0, "a long step")
    with pytest.raises(Spent), clock.limited():
        while clock.spent_s < 5.0:
            time.sleep(0.01)
    assert clock.spent_s < 0.5 and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    with pytest.raises(Spent), clock.limited():
        pytest.fail("nothing is begun when the time is spent")


def test_a_person_confirms_every_recording(tmp_path: Path, made_up: Callable[..., list[str]],
                                           monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    recorded = made_up(NAMED)
    out = tmp_path / "i"
    command = ["investigate", "--rig", str(RIG), "--out", str(out), "--quiet"]
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    assert cli.main(command) == 2
    assert "--yes: nobody is there to confirm each recording" in capsys.readouterr().err and recorded == []
    answers = iter("yyn")
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    assert cli.main(command) == 0
    assert check_journal(out, "declined")["why"] == "run03.mcap was declined." and len(recorded) == 2
    assert capsys.readouterr().out.count("The leg will move: hardwired emergency stop at hand") == 3
    monkeypatch.setattr("builtins.input", lambda question: pytest.fail("--yes asks nobody"))
    recorded.clear()
    found = legid.investigate(RIG, tmp_path / "j", yes=True)
    assert found.ending == "settled" and len(recorded) == len(found.to_frame()) and len(found.plot().axes) == 1
    assert found.verdict == "named" and "One answer stands" in str(found) and "quadratic_drag" in found._repr_html_()
    found.to_json(tmp_path / "again.json")
    again, written = (json.loads((tmp_path / name).read_text()) for name in ("again.json", "j/investigation.json"))
    assert {k: v for k, v in again.items() if k != "provenance"} == {
        k: v for k, v in written.items() if k != "provenance"}
    assert again["provenance"]["runs"] == written["provenance"]["runs"]


def test_a_first_run_that_gives_no_model_is_followed_by_one_with_more_torque(
        tmp_path: Path, made_up: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    made_up(NAMED)
    plain, errors = fit_runs, iter([legid.FitError("too little motion"), InputError("a", "not positive")])

    def fitted(*given: Any) -> Any:
        error = next(errors, None)
        if error is not None:
            raise error
        return plain(*given)

    monkeypatch.setattr(investigate, "fit_runs", fitted)
    done = run(tmp_path / "i")
    first = [one for one in done.steps[0].experiments if one.kind == "first"]
    assert done.ending == "settled" and len(first) >= 2
    assert all(b.peak_nm > a.peak_nm for a, b in pairwise(first))


def test_a_limit_that_trips_ends_the_run_and_keeps_it(tmp_path: Path) -> None:
    """Really recorded: the knee leaves its limit in the first gentle run, whose torque is then off."""
    (tmp_path / "rig.toml").write_text(RIG.read_text().replace("q2_rad = 3.0", "q2_rad = 0.05"))
    done = investigate_rig(tmp_path / "rig.toml", tmp_path / "i", 600.0, Asked(lambda what: False, "none"),
                           lambda files: legid_origin())
    assert done.ending == "failed" and "limit q2_rad tripped" in done.steps[0].experiments[0].ended
    assert (tmp_path / "i" / done.runs[0]).is_file() and len(done.runs) <= investigate.TRIPS
    check_journal(tmp_path / "i", "failed")


def legid_origin() -> Any:
    from experiments.provenance import origin_of

    return origin_of()


def test_a_device_that_is_absent_is_an_error_with_nothing_recorded(tmp_path: Path) -> None:
    with pytest.raises((WorkError, legid.DriverError)):
        run(tmp_path / "i")
    assert list((tmp_path / "i").glob("*.mcap")) == []


@pytest.mark.slow
def test_the_verdict_is_that_of_diagnose_on_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(investigate, "SECONDS", 6.0)
    out = tmp_path / "i"
    assert cli.main(["investigate", "--rig", str(RIG), "--emulate", "torque_offset", "--out", str(out), "--workers",
                     "1", "--budget", "20"]) == 0
    runs = sorted(map(str, out.glob("run*.mcap")))
    last = max(out.glob("diagnosis*.json"))
    found = json.loads((out / "investigation.json").read_text())
    assert found["diagnosed"] == [Path(one).name for one in runs]
    assert cli.main(["diagnose", *runs, "--rig", str(out / "rig.toml"), "--workers", "1", "--json",
                     str(tmp_path / "d.json")]) == 0
    own, theirs = (json.loads(path.read_text()) for path in (last, tmp_path / "d.json"))
    for document in (own, theirs):
        del document["provenance"], document["wall_s"]
    assert own == theirs and found["answer"]["verdict"] == own["verdict"] in ("named", "one_of")
