"""One case through the command line: the library without an effect, crashes, limits, and what is kept of them."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from pytest import MonkeyPatch, mark

from evidence.blind import run
from evidence.blind.plan import PlannedCase
from tests.support.paths import ROOT

CASE = PlannedCase("bench", "deleted torque_offset", 1)


def stub(monkeypatch: MonkeyPatch, program: str) -> None:
    """The command is replaced: what a diagnosis costs is not the matter here."""
    monkeypatch.setattr(run, "command_of", lambda case, cases, answer, share: [
        sys.executable, "-c", program, "--json", str(answer)])


@mark.slow
def test_a_deleted_effect_is_gone_from_the_command_s_library(tmp_path: Path) -> None:
    def effects(*command: str) -> list[str]:
        file = tmp_path / "effects.json"
        subprocess.run([*command, "effects", "--json", str(file)], check=True, capture_output=True, cwd=ROOT)
        return [e["effect"] for e in json.loads(file.read_text())["effects"]]

    every = effects(*run.COMMAND)
    assert effects(sys.executable, "-c", run.WITHOUT, "backlash") == [e for e in every if e != "backlash"]
    wrong = subprocess.run([sys.executable, "-c", run.WITHOUT, "no_such", "effects"], capture_output=True, text=True)
    assert wrong.returncode == 1 and "no effect no_such" in wrong.stderr


def test_a_deleted_case_is_diagnosed_without_its_effect() -> None:
    command = run.command_of(CASE, Path("c"), Path("a"), 2)
    assert command[-2:] == ["--workers", "2"]
    assert command[:4] == [sys.executable, "-c", run.WITHOUT, "torque_offset"]
    assert command[4] == "diagnose" and command.count("--rig") == 1
    assert run.WITHOUT not in run.command_of(PlannedCase("bench", "single torque_offset", 1), Path("c"), Path("a"))


def test_an_answer_is_kept_with_its_times(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    stub(monkeypatch, "import json,os,sys,time\nwhile time.process_time() < 0.2: pass\n"
                      "json.dump({'verdict': 'none', 'causes': [], 'session': os.getsid(0)}, open(sys.argv[2], 'w'))")
    found = run.diagnose(CASE, tmp_path, tmp_path)
    assert json.loads((tmp_path / f"{CASE.name}.json").read_text()) == found and not list(tmp_path.glob("*.part"))
    assert found["verdict"] == "none" and found["bench"]["status"] == 0 and not found["bench"]["crashed"]
    assert found["bench"]["cpu_s"] >= 0.2 and found["bench"]["wall_s"] > 0.2
    assert found["session"] != os.getsid(0), "an interrupt of the bench would reach the diagnosis"


@mark.parametrize("program, limit_s, said", [("raise SystemExit('broken')", run.LIMIT_S, "broken"),
                                                    ("import time; time.sleep(60)", 0.5, ".*not done.*")])
def test_a_crash_and_a_diagnosis_past_its_limit_are_recorded(program: str, limit_s: float, said: str, tmp_path: Path,
                                                             monkeypatch: MonkeyPatch) -> None:
    stub(monkeypatch, program)
    found = run.diagnose(CASE, tmp_path, tmp_path, limit_s=limit_s)
    assert found["verdict"] == "fit_failed" and found["bench"]["crashed"]
    assert re.fullmatch(said, found["bench"]["said"])


def test_the_command_s_own_refusal_is_recorded(tmp_path: Path) -> None:
    """The real command, on runs that are not there."""
    case = PlannedCase("bench", "none", 77)
    found = run.diagnose(case, tmp_path, tmp_path)
    assert found["bench"]["status"] == 2 and found["bench"]["said"].startswith("legid diagnose: ")
    assert json.loads((tmp_path / "none-77.json").read_text()) == found


def test_seeds_are_numbers_and_spans() -> None:
    assert run.parse_seeds("3,7-9") == [3, 7, 8, 9]
