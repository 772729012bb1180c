"""The fault matrix of the example board: what goes wrong x when -> how long the board's torque outlives it.

    python -m evidence port-faults --out docs/evidence/port-faults.md        # what `make port-faults` does
"""

import argparse
import multiprocessing
import tempfile
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import numpy as np

from evidence.kept import kept
from evidence.port_fault_list import FAULTS
from evidence.registry import Evidence
from tests.support.fault_bench import MOMENTS, PEAK_NM
from tests.support.port_bench import WATCHDOG_MS, Outcome, PortBench, load_once, prompt
from tests.support.qemu_board import elf

TARGET_MS = 110.0
TRIES = 4
Key = tuple[str, str]


def strike(name: str, moment: str, folder: Path, seed: int) -> Outcome:
    """One cell; begun again where a busy computer ended the recording before the fault came."""
    for _ in range(TRIES):
        found = PortBench(FAULTS[name].act, moment, seed).run(folder)
        if found.struck:
            break
    if found.clock == "emulator":
        return found._replace(zero_ms=max(0.0, found.zero_ms - FAULTS[name].stood_s * 1e3))
    return found


def wrong(name: str, moment: str, cell: Outcome) -> str:
    """What must not be, empty where nothing is."""
    found, borne = [], moment in FAULTS[name].borne
    if not cell.struck:
        found.append("the recording ended before the fault came, time and again")
    if cell.driven_on and not borne and cell.zero_ms > TARGET_MS:
        found.append("driven to the plan's end")
    if not cell.driven_on and cell.zero_ms > TARGET_MS and not borne:
        found.append(f"torque for {cell.zero_ms:.0f} ms")
    if cell.strongest_nm > PEAK_NM + 1e-3:
        found.append(f"driven with {cell.strongest_nm:.2f} N m")
    if "ARMED" in cell.board.split(", "):
        found.append("armed at the end")
    if "bridge" in cell.board and "bridge at 0 N m" not in cell.board:
        found.append("driven at the end")
    if "Traceback" in cell.said or "internal error" in cell.said or cell.status not in (0, 1, -9):
        found.append(f"status {cell.status}: {cell.said}")
    return ", ".join(found)


@kept
def _cell(work: tuple[str, str, int]) -> tuple[Key, Outcome]:
    name, moment, seed = work
    with tempfile.TemporaryDirectory(prefix="leg_cell_") as folder:
        return (name, moment), strike(name, moment, Path(folder), seed)


def _begin() -> None:
    elf()
    with tempfile.TemporaryDirectory() as folder:
        load_once(Path(folder))


def page(cells: dict[Key, Outcome], seed: int) -> str:
    """The matrix as a dated page."""
    ended = {key: cell for key, cell in cells.items() if not cell.driven_on}
    zero = np.array([cell.zero_ms for cell in ended.values()])
    bad = {key: what for key, cell in cells.items() if (what := wrong(*key, cell))}
    lines = [
        f"# Faults of the example board's line, {date.today()}", "",
        f"By `make port-faults`: {len(cells)} recordings with `legid record` on the example board in QEMU, over its "
        "UART, in real time. Each has one fault of the bytes, the board or the program at one moment. Torque up to "
        f"{PEAK_NM:g} N m, a watchdog of {WATCHDOG_MS} ms, default `[limits]`, a rig without IMU; 2 cores, x86-64; "
        f"seeds from {seed}.", "",
        f"- {len(ended)} recordings ended at the fault: torque zero after {np.median(zero):.0f} ms in the median, "
        f"{zero.max():.0f} ms at most; {int((zero <= TARGET_MS).sum())} within {TARGET_MS:g} ms. "
        f"{len(cells) - len(ended)} tolerated it and finished their plan.",
        "- Time counts from the fault, or from the first torque if that is later, to the last torque of the board's "
        "current loop. Both are ticks of the board, to half a millisecond. `*`: the board was reset with its torque "
        "on, and the end is the emulator's time of the reset.",
        "- `arming`: as Arm goes out. `ramp`: 60 ms into the plan. `driving`: 0.85 s into it. `stopping`: 20 ms after "
        "a SIGTERM. `on`: the plan went on, which these faults may allow; its torque never exceeded the plan's peak.",
        "- Real time on a shared computer: a thread may be some milliseconds late. A recording that ended before its "
        "fault was repeated.",
        "- If the emulator's clock or processor stood, the time is the board's, or the emulator's without the pause.",
        ""]
    nothing = ("Nothing: no cell beyond the target, no torque beyond the plan's peak, no board armed at the end, no "
               "recording without one line that says why it ended.")
    listed = [f"- {name} ({moment}): {what}" for (name, moment), what in bad.items()]
    lines += ["## What should not be", "", *(listed or [nothing]), ""]
    lines += ["## Time to zero torque [ms]", "", "| fault | " + " | ".join(MOMENTS) + " |",
              "| --- |" + " ---: |" * len(MOMENTS)]
    lines += [f"| {name} | " + " | ".join(_time(cells.get((name, moment))) for moment in MOMENTS) + " |"
              for name in FAULTS if any((name, moment) in cells for moment in MOMENTS)]
    lines += ["", "## What was said, what the file holds, what the board says at the end, at `driving`", "",
              "| fault | said | file | board |", "| --- | --- | --- | --- |"]
    lines += [f"| {name} | {cell.said or ('killed' if cell.status == -9 else 'the plan was driven to its end')} "
              f"| {cell.kept} | {cell.board} |"
              for name in FAULTS if (cell := cells.get((name, "driving"))) is not None]
    return "\n".join(lines) + "\n"


def _time(cell: Outcome | None) -> str:
    if cell is None:
        return ""
    return "on" if cell.driven_on else f"{cell.zero_ms:.0f}{'*' if cell.clock == 'emulator' else ''}"


EVIDENCE = (
    Evidence("Every fault of the example board's line, program and board, in real time", "make port-faults",
             "port-faults.md", 15, f"zero torque within {TARGET_MS:g} ms",
             (r"torque zero after \d+ ms in the median, \d+ ms at most; \d+ within \d+ ms",)),)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", nargs="+", default=[""], help="faults whose name contains one of these")
    parser.add_argument("--moments", nargs="+", default=MOMENTS, choices=MOMENTS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--boards", type=int, default=2, help="at a time")
    parser.add_argument("--out", type=Path, help="the page to write; printed without it")
    args = parser.parse_args(arguments)
    keys = [(name, moment) for name in FAULTS if any(part in name for part in args.only)
            for moment in args.moments]
    work = [(*key, args.seed + k) for k, key in enumerate(keys)]
    cells: dict[Key, Outcome] = {}
    with prompt():  # says so at once where that right is missing
        pass
    for boards, share in ((args.boards, [one for one in work if not FAULTS[one[0]].busy]),
                          (1, [one for one in work if FAULTS[one[0]].busy])):
        with multiprocessing.get_context("spawn").Pool(boards, _begin) as pool:  # each forks, and has no thread
            for key, cell in pool.imap_unordered(_cell, share):
                cells[key] = cell
                print(f"{', '.join(key)}: {cell} {wrong(*key, cell)}", flush=True)
    text = page(cells, args.seed)
    if args.out is not None:
        args.out.write_text(text)
    else:
        print(text)
    return int(any(wrong(*key, cell) for key, cell in cells.items()))
