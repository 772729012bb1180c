"""The fault matrix of the example board: what goes wrong x when -> how long the board's torque outlives it.

    python -m evidence port-faults --out docs/evidence/port-faults.md        # what `make port-faults` does
"""

import multiprocessing
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evidence.frame import Lines, new_folder, program, table, tell
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
    with new_folder() as folder:
        return (name, moment), strike(name, moment, folder, seed)


def _begin() -> None:
    elf()
    with new_folder() as folder:
        load_once(folder)


def page(only: Sequence[str] = ("",), moments: Sequence[str] = MOMENTS, boards: int = 2, seed: int = 1) -> Lines:
    keys = [(name, moment) for name in FAULTS if any(part in name for part in only) for moment in moments]
    work = [(*key, seed + k) for k, key in enumerate(keys)]
    done: dict[Key, Outcome] = {}
    with prompt():  # says so at once where that right is missing
        pass
    for count, busy in ((boards, False), (1, True)):
        with multiprocessing.get_context("spawn").Pool(count, _begin) as pool:  # each forks, and has no thread
            for key, cell in pool.imap_unordered(_cell, [one for one in work if FAULTS[one[0]].busy == busy]):
                done[key] = cell
                tell(*key, cell, wrong(*key, cell))
    cells = {key: done[key] for key in keys}
    zero = np.array([cell.zero_ms for cell in cells.values() if not cell.driven_on])
    bad = [f"- {name} ({moment}): {what}" for (name, moment), cell in cells.items()
           if (what := wrong(name, moment, cell))]
    yield from [
        "# Faults of the example board's line",
        f"{len(cells)} recordings with `legid record` on the example board in QEMU, over its "
        "UART, in real time. Each has one fault of the bytes, the board or the program at one moment. Torque up to "
        f"{PEAK_NM:g} N m, a watchdog of {WATCHDOG_MS} ms, default `[limits]`, a rig without IMU; 2 cores, x86-64; "
        f"seeds from {seed}.",
        f"- {zero.size} recordings ended at the fault: torque zero after {np.median(zero):.0f} ms in the median, "
        f"{zero.max():.0f} ms at most; {int((zero <= TARGET_MS).sum())} within {TARGET_MS:g} ms. "
        f"{len(cells) - zero.size} tolerated it and finished their plan.",
        "- Time counts from the fault, or from the first torque if that is later, to the last torque of the board's "
        "current loop. Both are ticks of the board, to half a millisecond. `*`: the board was reset with its torque "
        "on, and the end is the emulator's time of the reset.",
        "- `arming`: as Arm goes out. `ramp`: 60 ms into the plan. `driving`: 0.85 s into it. `stopping`: 20 ms after "
        "a SIGTERM. `on`: the plan went on, which these faults may allow; its torque never exceeded the plan's peak.",
        "- Real time on a shared computer: a thread may be some milliseconds late. A recording that ended before its "
        "fault was repeated.",
        "- If the emulator's clock or processor stood, the time is the board's, or the emulator's without the pause.",
        "## What should not be",
        *(bad or ["Nothing: no cell beyond the target, no torque beyond the plan's peak, no board armed at the end, no "
                  "recording without one line that says why it ended."]), "## Time to zero torque [ms]"]
    yield table(f"fault | {' | '.join(MOMENTS)}", (
        (name, *(_time(cells.get((name, moment))) for moment in MOMENTS)) for name in dict(keys)))
    yield "## What was said, what the file holds, what the board says at the end, at `driving`"
    yield table("fault | said | file | board", (
        (name, cell.said or ("killed" if cell.status == -9 else "the plan was driven to its end"), cell.kept,
         cell.board) for (name, moment), cell in cells.items() if moment == "driving"))
    return len(bad)


def _time(cell: Outcome | None) -> str:
    if cell is None:
        return ""
    return "on" if cell.driven_on else f"{cell.zero_ms:.0f}{'*' if cell.clock == 'emulator' else ''}"


EVIDENCE = Evidence(
    "Every fault of the example board's line, program and board, in real time", "make port-faults",
    "port-faults.md", 15, f"zero torque within {TARGET_MS:g} ms",
    (r"torque zero after \d+ ms in the median, \d+ ms at most; \d+ within \d+ ms",))
main = program(page)
