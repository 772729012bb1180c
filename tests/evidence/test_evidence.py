"""One runner, one index: every program that measures is in both, and the index is what programs and pages say."""

import re
import subprocess
import sys

import pytest

from evidence import untuned
from evidence.__main__ import main
from evidence.registry import INDEX, Evidence, evidence, index
from tests.support.paths import ROOT, needs_records

PAGES = {path.name for path in INDEX.parent.glob("*.md")} - {"index.md", "limits.md"}


def test_the_index_is_what_programs_and_pages_say() -> None:
    assert INDEX.read_text(encoding="utf-8") == index(), "python -m evidence --index"


def test_every_page_has_a_line_and_every_line_a_page() -> None:
    assert {one.page for many in evidence().values() for one in many} == PAGES


def test_every_target_of_make_that_a_line_names_runs_that_program() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for name, many in evidence().items():
        for one in many:
            words = one.command.split()
            if words[0] == "make":
                recipe = re.search(rf"^{words[1]}: .*\n((?:[\t#].*\n|endif.*\n)+)", makefile, re.MULTILINE)
                assert recipe is not None and f"evidence {name}" in recipe[1], one.command
            else:
                assert words[:4] == ["python", "-m", "evidence", name], one.command


@pytest.mark.parametrize("name", sorted(evidence()))
def test_every_program_says_its_arguments(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status = main([name, "--help"])
    except SystemExit as ended:
        assert not ended.code
    else:
        assert status == 0
    assert "usage" in capsys.readouterr().out


def test_the_runner_lists_runs_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "make imu-links" in capsys.readouterr().out
    assert main(["no-such-thing"]) == 2
    assert main(["fault-list"]) == 2
    assert "part of other programs" in capsys.readouterr().err
    done = subprocess.run([sys.executable, "-m", "evidence", "clock-laws", "--runs", "1"], cwd=ROOT, text=True,
                          capture_output=True, check=True)
    assert "outside the bound" in done.stdout and "minutes" in done.stderr


def test_a_page_without_its_result_is_refused() -> None:
    with pytest.raises(ValueError, match="has no result of `make soak`"):
        Evidence("what", "make soak", "soak.md", 1.0, "none", ("no such sentence",)).line()


@needs_records
def test_a_spoilt_servo_is_refused_for_what_was_spoilt() -> None:
    """Its files are driven by volts, and its rig file says so."""
    (case,) = (case for case in untuned.cases() if case[:2] == ("servo", "degrees for radians"))
    status, said = untuned.fitted(case[3], case[2])
    assert status == 1 and case[4] in said
