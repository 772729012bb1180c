"""Tiers of tests: the file that has them names tests, and the tool that writes it takes what is over its limit."""

from pathlib import Path

import pytest

from tests.tools import tiers


def test_every_case_of_a_tier_is_a_test(unknown_cases: set[str]) -> None:
    assert not unknown_cases


def test_cases_over_the_limit_are_slow_and_whole_functions_are_named_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, report = tmp_path / "tiers.toml", tmp_path / "times.xml"
    monkeypatch.setattr(tiers, "TIERS", file)
    monkeypatch.setattr("sys.argv", ["tiers", str(report), "--over", "2"])
    tiers.write({"slow": ["a/test_b.py::test_before"], "study": []})
    cases = {"test_one[1]": 3.0, "test_one[2]": 2.5, "test_two[x's]": 3.0, "test_two[y]": 0.1, "test_three": 0.2}
    report.write_text("<testsuites>" + "".join(
        f'<testcase classname="tests.a.test_b" name="{name}" time="{seconds}"/>' for name, seconds in cases.items())
        + '<testcase classname="tests.test_cases" name="test_kept" time="9"/></testsuites>')
    tiers.main()
    assert tiers.read() == {"slow": ["a/test_b.py::test_before", "a/test_b.py::test_one", "a/test_b.py::test_two[x's]"],
                            "study": []}
