"""Files made to hang, to fill the memory, to crash a reader or to lead elsewhere, through the commands that read them.

    python -m evidence attacks --out docs/evidence/attacks.md     # what `make attacks` does
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from evidence.registry import Evidence
from tests.support.hostile_files import ATTACKS
from tests.support.measured_command import measured

EVIDENCE = (
    Evidence("Files made to do harm, through the commands that read them", "make attacks", "attacks.md", 4,
             "one line, below 10 s and 1 GB", (r"\d+ of \d+ end in one line", r"slowest [\d.]+ s", r"most \d+ MB")),)


def call(command: Sequence[str], folder: Path) -> tuple[int, str, float, float]:
    """Exit status, last line, seconds of a processor and MB of `legid COMMAND`, its children included."""
    found = measured(command, folder)
    lines = (found.out + found.error).strip().splitlines()
    return found.status, lines[-1] if lines else "", found.seconds, found.megabytes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print or write; 1 where one did harm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="the page to write; printed without it")
    args = parser.parse_args(arguments)
    rows, good, slowest, most = [], 0, 0.0, 0.0
    for name, (make, command) in ATTACKS.items():
        with tempfile.TemporaryDirectory() as place:
            file = make(Path(place))
            words = [file if word == "FILE" else word for word in command]
            status, said, seconds, megabytes = call(words, Path(place))
        fine = status in (0, 1, 2) and "internal error" not in said
        good, slowest, most = good + fine, max(slowest, seconds), max(most, megabytes)
        cells = (name, command[0], status, f"{seconds:.1f}", f"{megabytes:.0f}", said[:160].replace("|", "/"))
        rows.append(f"| {' | '.join(map(str, cells))} |")
    text = "\n".join([
        f"# Files made to do harm, {datetime.now(UTC):%Y-%m-%d}", "",
        f"By `make attacks`: {len(rows)} files, each through one command. Time is that of the processor and memory the "
        "largest process, the child that reads the file included; both are at most so large.", "",
        f"- {good} of {len(rows)} end in one line or do no harm; slowest {slowest:.1f} s, most {most:.0f} MB.", "",
        "| file | command | status | time [s] | memory [MB] | last line |", "| --- | --- | ---: | ---: | ---: | --- |",
        *rows, ""])
    args.out.write_text(text, encoding="utf-8") if args.out else print(text)
    return int(good < len(rows))
