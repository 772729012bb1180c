"""`make evidence`: how often does `legid diagnose` name what is hidden, and nothing else, by hundreds of fresh cases?

Every family of legs in one plan in random order. What is done when the minutes are over is a random sample of it.
Called again it goes on where it stopped; after a change of the program it begins anew.
"""

import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import takewhile
from pathlib import Path
from typing import Any

from estimator import cores, worker_pool
from estimator.diagnosis import MATERIAL
from evidence.blind.page import COLUMNS, answer_file, read, tables
from evidence.blind.plan import FAMILIES, RECORDS, PlannedCase, choose, here, one_round, plan
from evidence.blind.run import diagnose, failed, keep, parse_seeds
from evidence.frame import Lines, program, tell
from evidence.kept import FOLDER, source_hash
from evidence.registry import Evidence
from tests.support.paths import REAL

LEGS = (f"A single cause is material from an error of {1.0 + MATERIAL:g} floors on. A leg with a cause outside the "
        "library has no right name. `one_of` with the truth in it counts as truth in the answer. A torque offset and "
        "asymmetric friction have the same effect on any record, so their `one_of` is never exact.")
FAULTS = ("The records are public ones of two arms (c0, a0), a servo and a prismatic axis. A seed draws the size of "
          "each fault, which is put into the readings.")


def answer(case: PlannedCase, folder: Path, share: int = 1) -> dict[str, Any]:
    """Make a case and have it diagnosed on `share` cores; the diagnosis JSON, which is kept. A maker that raises is a
    missing answer."""
    cases, out = (folder / case.family / name for name in ("cases", "diagnoses"))
    cases.mkdir(parents=True, exist_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    try:
        case.make(cases)
    except Exception as error:
        found = failed(f"not made: {type(error).__name__}: {error}")
        keep(found, case, out)
        return found
    return diagnose(case, cases, out, share=share)


def answer_all(cases: Iterable[PlannedCase], folder: Path, minutes: float, at_once: int) -> None:
    """Answer the cases that have no answer yet, `at_once` at a time. After so many minutes none is begun.

    Raises SystemExit after Ctrl-C, when those under way are answered.
    """
    began = time.monotonic()
    left = (case for case in cases if not answer_file(case, folder).exists())
    under_way: dict[Future[dict[str, Any]], PlannedCase] = {}

    def take(jobs: Iterable[Future[dict[str, Any]]]) -> None:
        for job in jobs:
            _tell(under_way.pop(job), job.result(), time.monotonic() - began)

    interrupted = False
    with worker_pool(at_once, "fork") as pool:
        try:
            for case in takewhile(lambda _: time.monotonic() < began + 60.0 * minutes, left):
                under_way[pool.submit(answer, case, folder, cores() if at_once == 1 else 1)] = case
                if len(under_way) == at_once:
                    take(wait(under_way, return_when=FIRST_COMPLETED).done)
            take(wait(under_way).done)
        except KeyboardInterrupt:
            print("interrupted: waiting for the diagnoses under way, which are kept", file=sys.stderr)
            interrupted = True
            take(wait(under_way).done)
    if interrupted:
        raise SystemExit(130)


def _tell(case: PlannedCase, found: dict[str, Any], seconds: float) -> None:
    error, bench = found.get("error") or {}, found["bench"]
    tell(f"{seconds / 60.0:.1f} min", case.family, case.name, found["verdict"],
         ", ".join(cause["effect"] for cause in found["causes"]), *error.values(), bench.get("wall_s"), bench["said"])


def page(minutes: float = 60.0, seed: int = 2000, families: Sequence[str] = tuple(FAMILIES), effects: str = "",
         seeds: str = "", at_once: int = 2, answers: str = str(FOLDER / "causes" / source_hash().hex()[:12])) -> Lines:
    """Of a random sample: all cases of a plan up to the first without an answer. EFFECTS: comma-separated parts of
    names, only cases that have one of them, each with SEED or SEEDS (N or A-B, several after commas)."""
    words, folder, there = list(filter(None, effects.split(","))), Path(answers), here(families)
    chosen = choose(there, words, parse_seeds(seeds) or [seed]) if words or seeds else None
    if chosen == []:
        raise SystemExit("no case has such a name, or its records are not next to the checkout")
    answer_all(chosen or plan(there, seed), folder, minutes, at_once)
    if chosen is None:
        done = list(takewhile(lambda case: answer_file(case, folder).exists(), plan(there, seed)))
        count = f"{len(done)} cases of a plan in random order, {len(one_round(0, there, seed))} a round"
    else:
        done = [case for case in chosen if answer_file(case, folder).exists()]
        count = f"{len(done)} of {len(chosen)} chosen cases"
    if not done:
        raise SystemExit("no case is done: give more minutes")
    yield from written(done, folder, count, there, at_once)


def written(cases: Sequence[PlannedCase], folder: Path, count: str, families: Sequence[str], at_once: int
            ) -> Iterator[str]:
    """The page, block by block; `count` says of how large a plan the cases are."""
    found, simulated = [case.seed for case in cases], [name for name in families if name != RECORDS]
    yield from ["# Causes that `legid diagnose` names" if simulated else "# Faults put into real records",
                f"Seeds {min(found)} to {max(found)}: {count}."]
    if simulated:
        yield from ["Simulators that share no code with legid made the legs. Each has eight runs of 20 s.",
                    *(f"- {name}: {FAMILIES[name].legs}" for name in families)]
    if not REAL.is_dir():
        yield "The family of real records is left out: ../shared/realdata is not next to the checkout."
    yield ("Errors are rms errors of free runs over the noise floor, as the diagnosis states them. Intervals are "
           f"Wilson's, 95 %. {LEGS if simulated else FAULTS}")
    yield from tables(read(cases, folder), at_once)


def _result(text: str) -> str:
    """Counts of the table's last row of rates, for the index."""
    row = next((line for line in text.splitlines() if line.startswith("| all |")), None)
    if row is None:
        raise ValueError("no row of all families")
    cells = [cell.strip(" *").split(" = ")[0] for cell in row.strip("|").split("|")[1:]]
    return "; ".join(f"{column.title} {cell}" for column, cell in zip(COLUMNS, cells) if cell != "-")


def _found(text: str) -> str:
    """Counts of the page of real records, for the index."""
    counts = re.findall(r"\| (?:named or in the set|size inside its 95 % interval) \| (\d+/\d+)", text)
    if len(counts) != 2:
        raise ValueError("no rates of real records")
    return f"found {counts[0]}; sizes in their intervals {counts[1]}"


EVIDENCE = (
    Evidence("Hidden causes, healthy legs and causes outside the library: what does `legid diagnose` answer?",
             "make evidence", "causes.md", 60, "no alarm on 98 %; material singles exactly 85 %, in the answer "
             "95 %, wrong at most 2 %; pairs 75 %; outside 85 %", _result, r"Seeds (\d+ to \d+)"),
    Evidence("Faults put into the readings of real records: does `legid diagnose` find them?",
             "make evidence FAMILIES=records MINUTES=9", "real-records.md", 9, "-", _found, r"Seeds (\d+ to \d+)"))


main = program(page)
