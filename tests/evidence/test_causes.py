"""`make evidence`: the plan is a fair mixture, the page counts rightly, a study goes on where it stopped."""

import json
import sys
import time
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pytest import MonkeyPatch, approx, mark

from estimator.diagnosis.calibration import calibrated
from evidence.blind import causes, geared, run, servo
from evidence.blind.calibration import Stated, fit, left_out
from evidence.blind.page import COLUMNS, Column, answer_file, rate, read, sizes, tables
from evidence.blind.plan import BENCH, FAMILIES, HEALTHY, RECORDS, PlannedCase, choose, one_round, plan
from evidence.blind.score import Rate

LEGS = [name for name in FAMILIES if name != RECORDS]


def test_one_seed_makes_one_plan_and_another_another() -> None:
    first, again, other = (list(islice(plan(list(FAMILIES), seed), 300)) for seed in (2000, 2000, 3000))
    assert first == again and [(c.family, c.hidden) for c in first] != [(c.family, c.hidden) for c in other]
    assert len({(c.family, c.name) for c in first}) == len(first), "two cases would share a folder"


def test_a_round_has_every_cause_once_and_a_fifth_of_healthy_legs() -> None:
    cases = one_round(0, FAMILIES, 2000)
    hidden = Counter((c.family, c.hidden) for c in cases)
    untouched = {(RECORDS, name) for name in FAMILIES[RECORDS].hidden if name.endswith("untouched")}
    assert set(hidden) == {(name, h) for name, family in FAMILIES.items() for h in family.hidden} - untouched
    assert {hidden[key] for key in hidden if not key[1].startswith("none") and key[1] != "pair"} == {1}
    healthy = [c for c in cases if c.kind == "none"]
    assert 0.17 < len(healthy) / len(cases) < 0.23
    assert {c.family for c in healthy} == {"servo", "stickslip", "geared", "small_faults", BENCH}
    assert {c.seed for c in cases}.isdisjoint(c.seed for c in one_round(1, FAMILIES, 2000))
    assert {c.seed for c in cases} == set(range(2000, 2000 + HEALTHY))


def test_a_prefix_of_the_plan_is_a_fair_mixture() -> None:
    """Of 60 cases a kind has its share of the round, within four standard deviations of drawing without returning."""
    whole = one_round(0, LEGS, 2000)
    for seed in range(2000, 2010):
        part = list(islice(plan(LEGS, seed), 60))
        for kind, count in Counter(c.kind for c in whole).items():
            share = count / len(whole)
            sigma = (60 * share * (1 - share) * (1 - 60 / len(whole))) ** 0.5
            assert abs(sum(c.kind == kind for c in part) - 60 * share) < 4 * sigma, (seed, kind)


def test_untouched_records_come_first() -> None:
    first = list(islice(plan([BENCH, RECORDS], 1), 5))
    assert [c.hidden for c in first[:4]] == ["c0.untouched", "a0.untouched", "servo.untouched", "axis.untouched"]
    assert not first[4].hidden.endswith("untouched")


def test_single_cases_are_chosen_by_a_part_of_their_name() -> None:
    assert [c.name for c in choose(["geared"], ["none", "drag"], [401])] == [
        "none-401", "none_wandering-401", "quadratic_drag-401"]
    assert [c.name for c in choose([BENCH], ["backlash"], [5, 6])] == [
        f"{kind}-backlash-moderate-{seed}" for seed in (5, 6) for kind in ("single", "deleted")]
    assert len(choose(["servo"], [], [1])) == len(FAMILIES["servo"].hidden)


@mark.parametrize("family, hidden, kind, effects", [
    ("servo", "none", "none", ()), ("geared", "none_wandering", "none", ()), ("outside", "outside_worm", "outside", ()),
    ("geared", "gyro_bias", "single", ("gyro_bias",)), ("pairs", "gyro_scale+encoder_offset", "pair",
                                                        ("gyro_scale", "encoder_offset")),
    (BENCH, "deleted gyro_bias", "deleted", ("gyro_bias",)), (BENCH, "outside gyro_cubic", "outside", ()),
    (RECORDS, "a0.untouched", "record", ()), (RECORDS, "a0.torque_delay", "record", ("torque_delay",))])
def test_a_case_s_name_says_what_is_in_it(family: str, hidden: str, kind: str, effects: tuple[str, ...]) -> None:
    case = PlannedCase(family, hidden, 3)
    assert (case.kind, case.effects) == (kind, effects)
    if family == BENCH:
        pair = PlannedCase(BENCH, "pair", 3)
        assert pair.name == f"pair-{'-'.join(pair.effects)}-moderate-3"


def put(folder: Path, case: PlannedCase, verdict: str, found: list[str], before: float | None, crashed: str = "",
        size: float = 0.0, sure: float | None = None, listed: tuple[str, ...] = ()) -> PlannedCase:
    """An answer, and the truth that the case's name tells, its size 1.0."""
    for name in ("cases", "diagnoses"):
        (folder / case.family / name).mkdir(parents=True, exist_ok=True)
    (folder / case.family / "cases" / f"{case.name}.truth.json").write_text(json.dumps({"name": case.name, "effects": [
        {"effect": e, "joint": None, "also": [], "sizes": {"level": 1.0}} for e in case.effects]}))
    interval = [size - 0.5, size + 0.5]
    named = [{"effect": c, "joint": None, "size": [{"name": "level", "unit": "1", "value": size, "ci95": interval}]}
             for c in found]
    answer_file(case, folder).write_text(json.dumps({
        "verdict": verdict, "causes": named, "error": None if before is None else {"before": before, "after": 1.0},
        "probability": sure, "probability_in_library": sure,
        "immaterial": [{"effect": e, "joint": None, "size": []} for e in listed],
        "bench": {"wall_s": 10.0, "cpu_s": 9.0, "crashed": bool(crashed), "said": crashed}}))
    return case


def hand_made(folder: Path) -> list[PlannedCase]:
    def one(family: str, hidden: str, seed: int, *answer: Any, **more: Any) -> PlannedCase:
        return put(folder, PlannedCase(family, hidden, seed), *answer, **more)

    return [
        one("servo", "none", 1, "none", [], 1.0), one("servo", "none", 2, "unexplained", [], 1.7),
        one("servo", "none", 3, "fit_failed", [], None, crashed="not done after 900 s"),
        one("servo", "gyro_bias", 1, "named", ["gyro_bias"], 2.0, size=1.2),
        one("servo", "gyro_bias", 2, "partial", ["gyro_bias"], 1.3, size=2.0),
        one("servo", "gyro_bias", 3, "one_of", ["gyro_scale", "gyro_bias"], 1.9),
        one("servo", "gyro_bias", 4, "named", ["gyro_scale"], 6.0),
        one("servo", "gyro_bias", 5, "none", [], 1.2), one("servo", "gyro_bias", 6, "none", [], 1.05),
        one("servo", "gyro_bias", 7, "named", ["gyro_scale"], 1.05),
        one("servo", "gyro_bias", 8, "fit_failed", [], None, crashed="killed"),
        one("pairs", "gyro_scale+encoder_offset", 1, "named", ["gyro_scale", "encoder_offset"], 8.0, size=1.0),
        one("pairs", "gyro_scale+encoder_offset", 2, "named", ["gyro_scale"], 8.0, listed=("encoder_offset",)),
        one("pairs", "gyro_scale+encoder_offset", 3, "named", ["gyro_scale"], 8.0, listed=("gyro_bias",)),
        one("pairs", "gyro_scale+encoder_offset", 4, "none", [], 1.1, listed=("gyro_scale", "encoder_offset")),
        one("outside", "outside_worm", 1, "unexplained", ["gyro_scale"], 3.0),
        one("outside", "outside_worm", 2, "partial", ["gyro_scale"], 3.0),
        one("outside", "outside_worm", 3, "none", [], 1.4), one("outside", "outside_worm", 4, "none", [], 1.6),
        one(BENCH, "deleted gyro_bias", 1, "unexplained", [], 2.0),
        one(BENCH, "deleted gyro_bias", 2, "named", ["gyro_scale"], 2.0)]


def test_every_column_counts_what_its_title_says(tmp_path: Path) -> None:
    answers = read(hand_made(tmp_path), tmp_path)
    assert [rate(answers, column.count) for column in COLUMNS] == [
        Rate(1, 3), Rate(2, 6), Rate(3, 6), Rate(1, 6), Rate(1, 6), Rate(1, 4), Rate(2, 4), Rate(2, 6), Rate(2, 6),
        Rate(1, 5)]
    assert sizes(answers) == Rate(3, 4)
    assert [a.case.name for a in answers if a.right] == [
        "none-1", "gyro_bias-1", "gyro_bias-2", "gyro_bias-6", "gyro_scale+encoder_offset-1", "outside_worm-1",
        "outside_worm-3", "deleted-gyro_bias-moderate-1"]


def test_the_page_has_each_count_and_every_case_that_is_not_right(tmp_path: Path) -> None:
    cases = hand_made(tmp_path)
    text = "\n".join(causes.written(cases, tmp_path, "all", LEGS, 2))
    rows = [line for line in text.splitlines() if line.startswith("| servo |")]
    assert "1/3 = 33.3 %" in rows[0] and rows[0].count("/6 = ") == 4 and rows[0].count("| - |") == 3
    assert "| above 5 | 0/1" in text and "| up to 1.5 | 1/4" in text and "| not stated | 0/1" in text
    assert "singles that are not material 1 of 2, pairs 0 of 4." in text
    assert "Of 2 effects listed as present together with a name 1 were put in" in text
    assert "Cases without an answer: 2." in text
    assert "8 of 21 are right" in text and "| servo | none-3 | fit_failed (not done after 900 s) | - | - |" in text
    assert "| outside | outside_worm-2 | gyro_scale + ? | 3.00 | 1.00 |" in text
    assert rows[0].startswith("| servo | **1/3 = ") and "| pairs | - | - | - | - | - | **1/4 = " in text
    assert "| all | 3/4 = 75.0 % (30.1 to 95.4) | 10, 10, 10 | 9, 9, 9 |" in text
    listed = text.partition("## Cases that are not right")[2]
    assert listed.count("\n| ") == 2 + 13 and "gyro_bias-6" not in listed
    prose = [line for line in text.splitlines() if not line.startswith(("|", "#"))]
    assert len(" ".join(prose).split()) < 400
    assert "healthy: no alarm 1/3; material singles: named exactly 2/6" in causes._result(text)


def test_a_case_that_could_not_be_made_counts_as_a_miss(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    def broken(name: str, seed: int, out: Path) -> None:
        raise ValueError("no leg")

    monkeypatch.setitem(FAMILIES, "geared", FAMILIES["geared"].__class__("", broken, ("gyro_bias",)))
    case = PlannedCase("geared", "gyro_bias", 1)
    assert causes.answer(case, tmp_path)["bench"]["said"] == "not made: ValueError: no leg"
    (found,) = read([case], tmp_path)
    assert found.material and not found.right and [e["effect"] for e in found.outcome.hidden] == ["gyro_bias"]
    page = "\n".join(tables([found], 1))
    assert "| geared | gyro_bias-1 | fit_failed (not made: ValueError: no leg) | - | - |" in page


def test_stated_probabilities_stand_next_to_the_shares_of_true_answers(tmp_path: Path) -> None:
    answers = [
        (0.97, "servo", "gyro_bias", "named", ["gyro_bias"], 2.0, True),
        (0.97, "servo", "gyro_bias", "named", ["gyro_scale"], 2.0, False),
        (0.95, "servo", "gyro_bias", "one_of", ["gyro_scale", "gyro_bias"], 2.0, True),
        (0.6, "pairs", "gyro_scale+encoder_offset", "partial", ["gyro_scale"], 8.0, True),
        (0.7, "pairs", "gyro_scale+encoder_offset", "named", ["gyro_scale"], 8.0, False),
        (0.3, "servo", "gyro_bias", "none", [], 1.2, False), (1.0, "servo", "gyro_bias", "none", [], 1.05, True),
        (0.99, "outside", "outside_worm", "named", ["gyro_scale"], 3.0, False),
        (1.0, "outside", "outside_worm", "none", [], 1.4, True),
        (0.8, "outside", "outside_worm", "none", [], 1.6, False),
        (None, "outside", "outside_worm", "unexplained", [], 3.0, False)]
    cases = [put(tmp_path, PlannedCase(family, hidden, k), verdict, found, before, sure=sure)
             for k, (sure, family, hidden, verdict, found, before, _) in enumerate(answers)]
    assert [a.true for a in read(cases, tmp_path)] == [true for *_, true in answers]
    text = "\n".join(tables(read(cases, tmp_path), 1)).partition("## Stated probability")[2]
    assert "1 of 11 answers state no probability." in text
    rows = [[cell.split(" = ")[0] for cell in line.strip("| ").split(" | ")] for line in text.splitlines()
            if line.startswith(("| 0", "| all"))][:5]
    assert rows == [
        ["0 to 0.5", "1", "0.30", "0/1", "0/1", "-"], ["0.5 to 0.8", "2", "0.65", "1/2", "1/2", "-"],
        ["0.8 to 0.95", "1", "0.80", "0/1", "-", "0/1"], ["0.95 to 1", "6", "0.98", "4/6", "3/4", "1/2"],
        ["all", "10", "0.83", "5/10", "4/7", "1/3"]]


@mark.parametrize("column, hits, count, said", [
    (Column("x", lambda a: None, 0.05, at_most=True), 0, 100, "at most 5 %: met"),
    (Column("x", lambda a: None, 0.05, at_most=True), 0, 5, "at most 5 %: met, too few"),
    (Column("x", lambda a: None, 0.05, at_most=True), 50, 100, "at most 5 %: **missed**"),
    (Column("x", lambda a: None, 0.05, at_most=True), 1, 5, "at most 5 %: **missed**, too few"),
    (Column("x", lambda a: None, 0.85), 100, 100, "at least 85 %: met"),
    (Column("x", lambda a: None, 0.85), 10, 100, "at least 85 %: **missed**"),
    (Column("x", lambda a: None, 0.85), 0, 0, "at least 85 %: not run"), (Column("x", lambda a: None), 1, 2, "-")])
def test_a_target_is_met_missed_or_left_open(column: Column, hits: int, count: int, said: str) -> None:
    judged = column.judge(Rate(hits, count))
    assert judged.startswith(said) and ("too few" in judged) == ("too few" in said)


def test_a_study_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    """The command is replaced: what a diagnosis costs is not the matter here."""
    family = FAMILIES["geared"].__class__("", lambda name, seed, out: None, ("none", "gyro_bias", "torque_delay"))
    monkeypatch.setitem(FAMILIES, "geared", family)
    stub = "import json,sys; json.dump({'verdict': 'none', 'causes': []}, open(sys.argv[1], 'w'))"
    monkeypatch.setattr(run, "command_of", lambda case, cases, answer, share: [
        sys.executable, "-c", stub, str(answer)])
    cases = list(islice(plan(["geared"], 7), 5))
    causes.answer_all(cases[:3], tmp_path, 1.0, 2)
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.json")}
    assert {p.stem for p in before} == {case.name for case in cases[:3]}
    causes.answer_all(cases, tmp_path, 0.0, 2)
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.json")} == before, "begun after its minutes"
    causes.answer_all(cases, tmp_path, 1.0, 2)
    after = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.json")}
    assert {p.stem for p in after} == {case.name for case in cases} and before.items() <= after.items()


@mark.slow
def test_a_small_call_makes_diagnoses_and_writes_the_page(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    """A real healthy leg of four runs of four seconds, through the real command."""
    monkeypatch.setattr(geared, "SECONDS", 4.0)
    monkeypatch.setattr(servo, "RUNS", 4)
    began = time.monotonic()
    causes.main(["--families", "geared", "--effects", "none_w", "--seeds", "3", "--at-once", "1", "--minutes",
                 "5", "--answers", str(tmp_path / "kept"), "--out", str(tmp_path / "page.md")])
    (found,) = read([PlannedCase("geared", "none_wandering", 3)], tmp_path / "kept")
    assert not found.document["bench"]["crashed"] and found.before is not None
    assert found.document["bench"]["cpu_s"] > 0.0 and found.document["bench"]["wall_s"] < time.monotonic() - began
    text = (tmp_path / "page.md").read_text()
    assert "blind.causes --minutes 5.0 --families geared --effects none_w --seeds 3 --at-once 1" in text
    assert ": 1 of 1 chosen cases." in text and "| geared |" in text


def test_records_alone_have_a_page_of_their_own(tmp_path: Path) -> None:
    told = [
        ("untouched", "none", []), ("torque_delay", "named", ["torque_delay"]), ("encoder_scale", "none", [])]
    cases = [put(tmp_path, PlannedCase(RECORDS, f"a0.{fault}", 1), verdict, found, 1.2, size=1.0)
             for fault, verdict, found in told]
    text = "\n".join(causes.written(cases, tmp_path, "all", [RECORDS], 2))
    assert text.startswith("# Faults put into real records\n") and "Simulators" not in text
    assert "| of these on a0 | 1/2 = 50.0 %" in text


def test_a_calibration_finds_the_odds_of_answers_and_asks_other_families() -> None:
    rng = np.random.default_rng(3)
    odds = (0.5, 0.3, 0.4)
    answers = [Stated("ab"[k % 2], p, bool(rng.random() < calibrated(p, odds)))
               for k, p in enumerate(rng.uniform(0.0, 1.0, 20_000))]
    assert fit(answers) == approx(odds, abs=0.1)
    sure = [calibrated(p, fit(answers)) for p in (0.0, 0.2, 0.9, 1.0)]
    assert sure == sorted(sure) and sure[0] > 0.0 and sure[-1] < 1.0

    # of two families, one always right and one always wrong, each is told what the other makes likely
    right = [Stated("right", 0.99, True)] * 50
    wrong = [Stated("wrong", 0.99, False)] * 50
    told = left_out([*right, *wrong])
    assert max(told[:50]) < 0.1 and min(told[50:]) > 0.9
