"""Files that coverage chooses: libFuzzer, through Atheris, mutates what reaches new code of the readers.

    python -m evidence guided --minutes 20        # what `make guided` does; needs `pip install atheris`

Each format has a process whose readers run in it, as in `mutate_worker`. A file that ends it is read again by the
command's own way, which must refuse it in one line. What reached new code is kept in build/evidence/guided, from where
the next call goes on.
"""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from evidence.registry import Evidence
from tests.support.paths import ROOT

FOLDER = ROOT / "build/evidence/guided"
READERS = ("experiments.exchange", "experiments.simulators", "experiments.models", "daq", "rosbags", "mcap", "can",
           "msgspec", "scipy.io.matlab")
"""Code whose coverage guides; the rest of a process is as fast as ever."""
WAIT_S, MEMORY_MB = 60, 3000
"""By the clock, on a computer that does much else, and of the whole process; each file has a GB more than it had."""
LARGEST = 65_536
EVIDENCE = (
    Evidence("Broken files that coverage chooses, through every reader", "make guided", "fuzz.md", 45,
             "read, or refused in one line", (r"[\d,]+ files that coverage chose have \d+ faults",), "(none)",
             r"on (\d{4}-\d\d-\d\d), in two calls"),)


class Found(Exception):
    """A file that was neither read nor refused."""


class Session(NamedTuple):
    """One format's files."""

    format: str
    files: int
    edges: int
    """Of the readers' code that were reached."""
    faults: list[str]


def target(name: str, corpus: Path, options: list[str]) -> None:
    """Never returns: libFuzzer's loop over the reader of a format."""
    import atheris  # type: ignore[import-untyped,import-not-found,unused-ignore]

    with atheris.instrument_imports(include=list(READERS)):
        from evidence.mutate import formats
    from evidence.mutate_worker import BYTES, Kind, outcome, without_children

    work = corpus / ".." / f"{name}-work"
    work.mkdir(exist_ok=True)
    kind = formats(work)[name]
    path = Path("/dev/shm" if Path("/dev/shm").is_dir() else work) / f"guided-{name}{kind.ending}"
    if not any(corpus.iterdir()):
        for k, whole in enumerate(kind.whole):
            (corpus / str(k)).write_bytes(whole[:LARGEST])
    without_children()
    one = Kind(name, path, lambda number, path: None, kind.read)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()

    def attempt(data: bytes) -> None:
        path.write_bytes(data)
        _, fault = outcome(one)
        if fault:
            raise Found(fault)

    atheris.Setup([sys.argv[0], str(corpus), *options], attempt)
    resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    atheris.Fuzz()


def session(name: str, seconds: float) -> Session:
    """One format for so long [s], begun again after every file that ends it."""
    corpus, ends = FOLDER / name, FOLDER / f"{name}-ends"
    corpus.mkdir(parents=True, exist_ok=True)
    ends.mkdir(exist_ok=True)
    files, edges, faults, deadline = 0, 0, list[str](), time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 2.0:
        done = subprocess.run(
            [sys.executable, "-m", "evidence", "guided", "--target", name, f"-max_total_time={left:.0f}",
             f"-timeout={WAIT_S}", f"-rss_limit_mb={MEMORY_MB}", "-malloc_limit_mb=100000", "-print_final_stats=1",
             f"-max_len={LARGEST}", f"-artifact_prefix={ends}/"], cwd=ROOT, capture_output=True, text=True,
            errors="replace", check=False)
        counts = re.findall(r"^(?:stat::number_of_executed_units: |#)(\d+)", done.stderr, re.M)
        files += int(counts[-1]) if counts else 0
        edges = max([edges, *map(int, re.findall(r"cov: (\d+)", done.stderr))])
        if done.returncode:
            faults += _ended(name, ends, done.stderr)
            if not counts:
                break
    return Session(name, files, edges, faults)


def _ended(name: str, ends: Path, said: str) -> list[str]:
    """The fault of the file that ended a session, if the command's own way does not refuse it either."""
    from evidence.mutate import formats
    from evidence.mutate_worker import Kind, in_child

    found = [path for path in ends.iterdir() if path.suffix != ".seen"]
    if not found:
        return [f"{name}: ended without a file: {said[-500:]}"]
    faults = []
    kind = formats(ends)[name]
    for path in found:
        copy = ends / f"again{kind.ending}"
        copy.write_bytes(path.read_bytes())
        what, fault = in_child(Kind(name, copy, lambda number, path: None, kind.read))
        if fault or what == "crashed":
            faults.append(f"{name}, {path}: {what} {fault}")
        copy.unlink()
        path.rename(path.with_suffix(".seen"))
    return faults


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all formats in turn, print the page's table; 1 where a file is neither read nor refused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=20.0, help="of all formats together")
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--target", help=argparse.SUPPRESS)
    args, options = parser.parse_known_args(arguments)
    if args.target:
        target(args.target, FOLDER / args.target, options)
        return 0
    from evidence.mutate import NAMES

    names = args.only or [*NAMES]
    print("| format | files | edges of the readers | faults |\n| --- | ---: | ---: | ---: |", flush=True)
    done = []
    for name in names:
        done.append(session(name, 60.0 * args.minutes / len(names)))
        one = done[-1]
        print(f"| {NAMES.get(name, name)} | {one.files:,} | {one.edges:,} | {len(one.faults)} |", flush=True)
        for fault in one.faults:
            print(fault, file=sys.stderr, flush=True)
    faults = sum(len(one.faults) for one in done)
    print(f"\n{sum(one.files for one in done):,} files that coverage chose have {faults} faults.")
    return int(faults > 0)
