"""`make tutorial`: run docs/tutorial.md and docs/positions.md, put what their commands print into them, draw figures.

Every ```sh block is run in order, in one directory; the ```text block that follows it holds what it printed, or its
first lines where a comment `<!-- first N lines -->` stands before it. tests/test_tutorial.py holds the page to that.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "tutorial.md"
POSITIONS = ROOT / "docs" / "positions.md"
"""Goes on in the tutorial's folder."""
INSTALL = ["make install", 'export PATH="$PWD/.venv/bin:$PATH"', "mkdir -p my-leg && cd my-leg"]
"""The first block: it makes what this very process runs in."""
BLOCK = re.compile(r"```sh\n(?P<code>.*?)```\n"
                   r"(?:\n(?:<!-- first (?P<first>\d+) lines -->\n)?```text\n(?P<text>.*?)```\n)?", re.DOTALL)

PROGRESS = re.compile(r"[a-z][^:]*: (\d+ s so far|\d+ of \d+ \w+|.*, \d+ %|.*about \d+ s left.*)")
"""What `experiments.console` tells a log of long work: how fast the machine is decides whether there is such a line."""


@dataclass(frozen=True)
class Block:
    """Commands of the page and what it says that they print."""

    code: str
    text: str | None
    first: int | None


def blocks(page: str) -> list[Block]:
    """All ```sh blocks, in order."""
    return [Block(m["code"], m["text"], int(m["first"]) if m["first"] else None) for m in BLOCK.finditer(page)]


def run_blocks(some: list[Block], folder: Path) -> Iterator[str]:
    """What each block prints, stderr included, run in `folder` with this interpreter's `legid`.

    Raises `subprocess.CalledProcessError` for a block of which a command fails.
    """
    shims = folder.parent / "bin"
    shims.mkdir()
    for name, what in (("legid", f'"{sys.executable}" -m legid.cli'), ("python", f'"{sys.executable}"')):
        (shims / name).write_text(f'#!/bin/sh\nexec {what} "$@"\n')
        (shims / name).chmod(0o755)
    (folder.parent / "docs").symlink_to(ROOT / "docs")
    environment = os.environ | {"PATH": f"{shims}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    for block in some:
        yield subprocess.run(["bash", "-euc", block.code], cwd=folder, env=environment, text=True, check=True,
                             stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout


def shortened(said: str, first: int | None) -> str:
    """As the page shows it."""
    lines = [line.rstrip() for line in said.splitlines() if not PROGRESS.fullmatch(line)]
    return "".join(f"{line}\n" for line in (lines if first is None else [*lines[:first], "..."]))


def rewrite(page: str, said: list[str]) -> str:
    """The page with what its blocks printed."""
    outputs = iter(said)

    def with_text(m: re.Match[str]) -> str:
        new = next(outputs)
        if m["text"] is None:
            return m[0]
        start, stop = m.start("text") - m.start(), m.end("text") - m.start()
        return m[0][:start] + shortened(new, int(m["first"]) if m["first"] else None) + m[0][stop:]

    return BLOCK.sub(with_text, page)


def draw(folder: Path, out: Path) -> None:
    """The page's figures, from the runs and models in `folder`."""
    from experiments.reports.diagnosis_figures import error_bars
    from experiments.reports.figures import standalone
    from experiments.reports.validation import validation_picture
    from legid import diagnose, load, load_model, validate

    rig = folder / "rig.toml"
    runs = load([folder / f"run{n}.mcap" for n in range(1, 7)], rig)
    for name in ("nominal", "extended"):
        (seen,) = validate(load_model(folder / f"{name}.json"), [runs[3]], rig)
        (out / f"tutorial-{name}.svg").write_text(standalone(validation_picture(seen)), encoding="utf-8")
    (out / "tutorial-gain.svg").write_text(standalone(error_bars(diagnose(runs, rig).sensors)), encoding="utf-8")


def main() -> None:
    """Run, rewrite, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, action="append", help="the page; its figures go next to it")
    for page in parser.parse_args().page or [PAGE, POSITIONS]:
        text = page.read_text(encoding="utf-8")
        some = blocks(text)
        skipped = sum(block.code.splitlines() == INSTALL for block in some)
        with tempfile.TemporaryDirectory() as home:
            folder = Path(home) / "my-leg"
            folder.mkdir()
            said = [*[""] * skipped, *run_blocks(some[skipped:], folder)]
            page.write_text(rewrite(text, said), encoding="utf-8")
            if skipped:
                draw(folder, page.parent)


if __name__ == "__main__":
    main()
