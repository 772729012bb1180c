"""Make cases of the blind bench and have `legid diagnose` answer each, as a user would have it.

    python -m tests.evidence blind.run --classes none,single,pair,outside,deleted --seeds 1000-1003 --out OUT

writes OUT/cases (CSVs, rig.toml, truths) and OUT/diagnoses/NAME.json. What is there already is kept, so an
interrupted bench goes on where it stopped. Seeds 1 to 99 are for tuning, 1000 and up for the claim.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Protocol

from tests.evidence.blind.bench import generate
from tests.evidence.blind.cases import CLASSES, TARGETS, Case, catalogue
from tests.evidence.blind.effects import MAKERS

BATCH = 32
LIMIT_S = 900.0
COMMAND = (sys.executable, "-m", "experiments.cli")
# The command itself can leave no effect out, nor should it: a process of the bench takes one from the library first.
WITHOUT = """
import sys
from estimator.effects import registry
gone = sys.argv.pop(1)
every = registry.library_classes()
left = tuple(kind for kind in every if kind.name != gone)
if len(left) != len(every) - 1:
    sys.exit(f"the library has no effect {gone} to leave out")
registry.library_classes = lambda: left
from experiments.cli import main
sys.exit(main())
"""
Say = Callable[[str], None]


class Diagnosable(Protocol):
    """A folder of runs with a rig file, and the effect that is to be left out of the library where kind says so."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str: ...

    @property
    def effects(self) -> tuple[str, ...]: ...


def list_cases(classes: Sequence[str], seeds: Sequence[int], levels: Sequence[str] = ("moderate",),
               effects: Sequence[str] = ()) -> list[Case]:
    """Cases of the classes; `effects` keeps those that hide one of them (and class none, which hides nothing)."""
    found: dict[str, Case] = {}
    for kind in classes:
        for level in levels:
            for case in catalogue(kind, seeds, level=level):
                if not effects or not case.effects or set(case.effects) & set(effects):
                    found[case.name] = case
    return list(found.values())


def make_cases(cases: Sequence[Case], root: Path, say: Say = print, **options: Any) -> None:
    """Generate what is not there yet, in batches. A case's truth is written last, so it marks the case whole."""
    missing = [case for case in cases if not (root / f"{case.name}.truth.json").exists()]
    start = time.perf_counter()
    for done in range(0, len(missing), BATCH):
        generate(missing[done:done + BATCH], root, **options)
        count = min(done + BATCH, len(missing))
        say(f"made {count} of {len(missing)} cases, {_left(start, count, len(missing))}")


def command_of(case: Diagnosable, cases: Path, answer: Path, share: int = 1) -> list[str]:
    """The command line that diagnoses a case on `share` processes."""
    folder = cases / case.name
    without = [sys.executable, "-c", WITHOUT, case.effects[0]] if case.kind == "deleted" else list(COMMAND)
    runs = [str(folder / f"r{k}.csv") for k in range(1, len(list(folder.glob("r*.csv"))) + 1)]
    return [*without, "diagnose", *runs, "--rig", str(folder / "rig.toml"), "--json", str(answer),
            "--workers", str(share)]


def diagnose(case: Diagnosable, cases: Path, out: Path, limit_s: float = LIMIT_S, share: int = 1) -> dict[str, Any]:
    """Have one case diagnosed; its JSON, with exit status, wall time and last words as `bench`, is kept in `out`.

    A diagnosis that leaves no JSON (an internal error, a limit) is kept as `fit_failed`, with what it said.
    """
    answer = out / f"{case.name}.part"
    answer.unlink(missing_ok=True)
    start = time.perf_counter()
    try:
        # a session of its own: an interrupt of the bench must not be kept as a diagnosis that failed
        done = subprocess.run(command_of(case, cases, answer, share), capture_output=True, text=True, timeout=limit_s,
                              check=False, start_new_session=True)
        status, said = done.returncode, (done.stderr.strip().splitlines() or [""])[-1]
    except subprocess.TimeoutExpired:
        status, said = None, f"not done after {limit_s:.0f} s"
    found: dict[str, Any] = {"verdict": "fit_failed", "causes": []}
    crashed = True
    if status in (0, 1) and answer.exists():
        found, crashed = json.loads(answer.read_text(encoding="utf-8")), False
    found["bench"] = {"status": status, "wall_s": time.perf_counter() - start, "crashed": crashed,
                      "said": said if status != 0 else ""}
    answer.write_text(json.dumps(found, indent=1), encoding="utf-8")
    answer.replace(out / f"{case.name}.json")
    return found


def run_cases(cases: Sequence[Case], root: Path, workers: int = 2, limit_s: float = LIMIT_S,
              say: Say = print) -> None:
    """Diagnose every case that has no answer yet; seeds in turn, so that what is done at any time is a fair part."""
    out = root / "diagnoses"
    out.mkdir(parents=True, exist_ok=True)
    left = sorted((c for c in cases if not (out / f"{c.name}.json").exists()), key=lambda c: c.seed)
    say(f"{len(cases) - len(left)} of {len(cases)} cases are diagnosed already")
    start = time.perf_counter()
    pool, share = ThreadPoolExecutor(workers), max(1, (os.cpu_count() or 1) // workers)
    try:
        jobs = {pool.submit(diagnose, case, root / "cases", out, limit_s, share): case for case in left}
        for count, job in enumerate(as_completed(jobs), 1):
            found = job.result()
            names = ", ".join(c["effect"] for c in found["causes"])
            failed = f" ({found['bench']['said']})" if found["bench"]["crashed"] else ""
            say(f"{count}/{len(left)} {jobs[job].name}: {found['verdict']} {names}{failed}  "
                f"{found['bench']['wall_s']:.0f} s, {_left(start, count, len(left))}")
    except KeyboardInterrupt:
        say("interrupted: waiting for the diagnoses under way, which are kept")
        raise SystemExit(130) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _left(start: float, done: int, count: int) -> str:
    seconds = (time.perf_counter() - start) * (count - done) / done
    return f"{seconds / 60:.0f} min left" if count > done else "done"


def parse_seeds(text: str) -> list[int]:
    """N or A-B, several after commas."""
    return [seed for part in text.split(",") for seed in _span(part)]


def _span(text: str) -> Iterator[int]:
    low, _, high = text.partition("-")
    yield from range(int(low), int(high or low) + 1)


def _words(allowed: Sequence[str]) -> Callable[[str], list[str]]:
    def parse(text: str) -> list[str]:
        words = [word for word in text.split(",") if word]
        for word in words:
            if word not in allowed:
                raise argparse.ArgumentTypeError(f"{word!r} is none of {', '.join(allowed)}")
        return words
    return parse


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--classes", type=_words(CLASSES), default=list(CLASSES))
    parser.add_argument("--seeds", type=parse_seeds, required=True, help="N or A-B, several after commas")
    parser.add_argument("--levels", type=_words(tuple(TARGETS)), default=["moderate"])
    parser.add_argument("--effects", type=_words(tuple(MAKERS)), default=[], help="only cases that hide one of these")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds that one diagnosis may take")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    cases = list_cases(options.classes, options.seeds, options.levels, options.effects)

    def say(text: str) -> None:
        print(text, flush=True)

    make_cases(cases, options.out / "cases", say)
    run_cases(cases, options.out, options.workers, options.limit, say)
    return 0
