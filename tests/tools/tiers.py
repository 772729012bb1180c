"""Cases that take long go to `make test-slow`: tests/tiers.toml anew, from the times of a run of all fast tests.

    python -m pytest ... --junitxml=TIMES.xml   # on a machine that does nothing else
    python -m tests.tools.tiers TIMES.xml [--over SECONDS]

A case that is in KEPT stays in the fast tier whatever it takes: one whole verb a verdict, one of each guard of a motor.
"""

import argparse
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.support.paths import ROOT

TIERS = ROOT / "tests/tiers.toml"
KEPT = (
    "estimator/diagnosis/test_procedure.py::test_both_hidden_causes_are_the_answer_and_each_is_needed",
    "estimator/change/test_detect.py::test_a_changed_reading_is_named_with_its_size[gyro_scale",
    "experiments/workflows/test_tune.py::test_what_is_chosen_is_told_and_written",
    "legid/cli/test_against_cli.py::test_a_model_is_as_good_a_reference_as_its_runs",
    "daq/recording/test_safety.py::",
    "test_cases.py::",
)
"""Beginnings of node ids below tests/."""


def times(report: Path) -> Iterator[tuple[str, float]]:
    """Node id below tests/ and seconds of each case of a JUnit report, set-up of its fixtures included."""
    for case in ElementTree.parse(report).iter("testcase"):
        module = (case.get("classname") or "").removeprefix("tests.").replace(".", "/")
        yield f"{module}.py::{case.get('name')}", float(case.get("time") or 0.0)


def read() -> dict[str, list[str]]:
    """Tier to the node ids in it."""
    found: dict[str, list[str]] = tomllib.loads(TIERS.read_text(encoding="utf-8"))
    return found


def write(tiers: Mapping[str, list[str]]) -> None:
    """Write tests/tiers.toml."""
    lines = ["# Cases by tier, and what is neither slow nor study is fast; `tests/tools/tiers.py` writes this file.",
             "# A node id without brackets has all cases of a function."]
    for tier, names in tiers.items():
        quoted = (f"    {name!r}," if "'" not in name else f'    "{name}",' for name in sorted(names))
        lines += ["", f"{tier} = [", *quoted, "]"]
    TIERS.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Move every fast case over the limit to the slow tier."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("report", type=Path)
    parser.add_argument("--over", type=float, default=1.2, help="seconds from which on a case is slow")
    given = parser.parse_args()
    functions: dict[str, dict[str, bool]] = defaultdict(dict)
    for name, seconds in times(given.report):
        functions[name.partition("[")[0]][name] = seconds > given.over and not name.startswith(KEPT)
    over = {name for function, cases in functions.items()
            for name in ([function] if all(cases.values()) else [case for case, long in cases.items() if long])}
    tiers = read()
    tiers["slow"] = sorted({*tiers["slow"], *over})
    write(tiers)


if __name__ == "__main__":
    main()
