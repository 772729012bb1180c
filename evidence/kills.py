"""`make kills`: recordings killed at any moment, and with a second process at their devices and at their file.

`legid record`, with its own drivers over a port and a bus, on emulated rigs in processes of their own. A SIGKILL comes
at a moment drawn over the whole of a recording; what it leaves must hold every message that had been handed to the
system, be called cut off, and recover to a whole file; the next recording on the same devices must start. A second
process must leave the first whole. One of them is a stranger: it takes samples out of the IMU's FIFO and knows of no
lock, as a script does; that recording must end itself, or every reader flags it. A fault is everything else.
"""

import mmap
import os
import re
import signal
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq import InputError, load_rig
from daq.recording import write_plan
from daq.runs import read_run, recover
from daq.runs.mcap_run import FLUSH_MESSAGES
from daq.timing import configured
from evidence.frame import Lines, heard, new_folder, program, table, tell, within
from evidence.kept import kept
from evidence.kill_processes import COUNTS, PATIENCE_S, ended, served_rig, start, take, unlatch
from evidence.registry import Evidence
from legid.cli import main as legid
from tests.support.processes import favoured
from tests.support.recordings import sine
from tests.support.runs import load_run

PLAN_S, WHOLE_S = 0.6, 2.8
"""A plan, and a little more than a recording of it takes with its lead in."""
RATE_OFF = 0.06
"""By which an IMU's rate may be off the one that was set, in a run that nobody disturbed."""
EDGE_NS = 100_000_000
"""What is missing so near to either end of a run puts nothing else out of its time."""
STRANGER = "a stranger's reading"
"""What the command that knows no lock is called."""

PATIENT = ("[limits]\n" + "".join(f"{name} = 5.0\n" for name in (
    "staleness_s", "clock_bound_s", "echo_s", "torque_s", "encoder_s", "imu_stuck_s", "pivot_s")))
"""Limits that a computer which is busy with other work would trip."""


class Killed(NamedTuple):
    """What was found of one recording."""

    outcome: str
    """How the study counts it."""
    lost: int = 0
    """Messages that the writer had and the file has not."""
    fault: str = ""


def command_of(rig: Path, out: Path) -> list[str]:
    """A recording by the plan next to the rig file."""
    return ["record", "--rig", str(rig), "--plan", str(rig.with_name("plan.csv")), "--out", str(out)]


def kill_one(rig: Path, folder: Path, number: int, seed: int) -> Killed:
    """Record, kill at a moment drawn from seed and number, look at what is left."""
    path, said, counts = _files(folder, "kill_one", number)
    rng = np.random.default_rng((seed, number))
    unlatch(rig)
    pid = start(command_of(rig, path), said, counts)
    time.sleep(rng.uniform(0.0, WHOLE_S))
    os.kill(pid, signal.SIGKILL)  # one that has ended is a zombie still
    status = ended(pid)
    given, handed = COUNTS.unpack_from(counts)
    return _judge(path, status, given, handed, said.read_text() if said.exists() else "")


def _files(folder: Path, name: str, number: int) -> tuple[Path, Path, mmap.mmap]:
    """Where the run goes, and what was said; and the counts."""
    return folder / f"{name}-{number}.mcap", folder / f"{name}-{number}.txt", mmap.mmap(-1, COUNTS.size)


def _judge(path: Path, status: int | None, given: int, handed: int, said: str) -> Killed:
    if status == 0:
        raw = read_run(path)
        return Killed("ended before the kill", given - raw.messages, "" if raw.complete else "ended, and is not whole")
    if status != -signal.SIGKILL:
        return Killed("ended itself and said why", 0, _unexplained(path, status, said))
    if not path.exists():
        return Killed("before there was a file", given, "its file is gone" if given else "")
    try:
        raw = read_run(path)
    except InputError as error:
        return Killed("an empty file, refused", given, f"refused: {error}" if handed or "\n" in str(error) else "")
    lost = given - raw.messages
    faults = [f"{handed} messages had been handed over, {raw.messages} are left"] * (raw.messages < handed)
    told = [damage for damage in raw.damage if damage.kind == "cut"]
    faults += ["nobody says that its end is missing"] * (given != raw.messages and (raw.complete or not told))
    faults += [f"damaged within: {raw.damage}"] * (len(raw.damage) > len(told))
    saved = path.with_suffix(".saved.mcap")
    report, fixed = recover(path, saved), read_run(saved)
    faults += [f"recovered {report.messages} messages, {fixed.messages} are read"] * (
        not fixed.complete or fixed.messages != raw.messages)
    for command in (["info", str(path)], ["fit", str(path)]):
        with heard() as told_by:
            status = legid(command)
        text = told_by.getvalue()
        faults += [f"{command[0]} ends with {status}: {text[-300:]}"] * (
            status not in (0, 1, 2) or "internal error" in text or (command[0] == "info" and status != 0))
    return Killed("cut off, read and recovered" if raw.messages else "cut off before the first message", max(lost, 0),
                  "; ".join(faults))


def disturb_one(rig: Path, folder: Path, number: int, seed: int) -> Killed:
    """Record, and let a second process at the same devices or file meanwhile."""
    path, said, counts = _files(folder, "disturb_one", number)
    rng = np.random.default_rng((seed, number))
    unlatch(rig)
    other, heard = path.with_suffix(".other.mcap"), path.with_suffix(".heard.txt")
    refused = [command_of(rig, other), command_of(rig, path), ["doctor", "--rig", str(rig)],
               ["calibrate", "imu", "--rig", str(rig)]]
    harmless = [["info", str(path)], ["recover", str(path), "--out", str(other)], ["fit", str(path)]]
    pid = start(command_of(rig, path), said, counts)
    deadline = time.monotonic() + PATIENCE_S
    while not COUNTS.unpack_from(counts)[0] and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(rng.uniform(0.0, 1.5))
    command = [*refused, *harmless, [STRANGER]][rng.integers(len(refused + harmless) + 1)]
    if command == [STRANGER]:
        return _shared(pid, take(rig, seed + number, heard), path, said, heard)
    second = start(command, heard)
    first = ended(pid)
    going_on = command in refused and os.waitid(os.P_PID, second, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
    if going_on:  # it came to the devices when they were free again
        os.kill(second, signal.SIGKILL)
    status, what = ended(second), f"{command[0]} meanwhile" + " until it ended" * going_on
    text = heard.read_text()
    wanted = (-signal.SIGKILL, 1, 2) if going_on else (1, 2) if command in refused else (0, 1, 2)
    faults = [f"{what} ends with {status}: {text[-300:]}"] * (status not in wanted or "internal error" in text)
    faults += filter(None, [_disturbed(path, first, said.read_text())])
    return Killed(what + ("; the first ended itself and said why" if first else ""), 0, "; ".join(faults))


def _shared(first: int, stranger: int, path: Path, said: Path, taken: Path) -> Killed:
    """What came of a recording of whose IMU a stranger took samples."""
    status, other = ended(first), ended(stranger)
    if status:
        fault = _unexplained(path, status, said.read_text())
        return Killed(f"{STRANGER}; the first ended itself and said why", 0, fault)
    samples = read_run(path).streams["/imu"]
    first_ns, last_ns = samples["drain_after_ns"][0] + EDGE_NS, samples["drain_after_ns"][-1] - EDGE_NS
    bursts = [line.split() for line in taken.read_text().splitlines()] if not other else []
    taken_ones = np.frombuffer(bytes.fromhex("".join(burst for before_ns, after_ns, burst in bursts
                                                     if first_ns < int(before_ns) and int(after_ns) < last_ns)), "<i2")
    kept = {tuple(row) for row in _rows(samples).tolist()}
    lost = len({tuple(row) for row in taken_ones.reshape(-1, 6).tolist()} - kept)
    twice = int((np.diff(_rows(samples), axis=0) == 0).all(axis=1).sum())
    marked = bool(samples["gap_before"].any())
    flags = load_run(path, load_rig(path.with_name("rig.toml"))).flags
    found = "nothing lost"
    if lost or twice:
        found = "flagged" if flags else "its gaps are marked" if marked else "not a word"
    fault = f"{lost} samples are gone, {twice} came twice, without a word" if found == "not a word" else ""
    fault = fault or (f"flagged without a reason: {flags}" if flags and found == "nothing lost" and not bursts else "")
    return Killed(f"{STRANGER}; {found}", 0, f"the stranger ended with {other}" if other else fault)


def _rows(samples: NDArray[np.void]) -> NDArray[np.int16]:
    """(n, 6) counts."""
    return np.column_stack([samples[name] for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")])


def _unexplained(path: Path, status: int | None, said: str) -> str:
    """What is wrong with how a recording ended before its plan did: by a limit, on a computer that is too busy."""
    lines = [line for line in said.splitlines() if line.startswith("legid record: ")]
    if status == 1 and len(lines) == 1 and "internal error" not in lines[0]:
        return "" if not path.exists() or read_run(path).complete else f"is not whole, and said {lines[0]}"
    return f"ended with {status}: {said.strip()[-300:]}"


def _disturbed(path: Path, status: int | None, said: str) -> str:
    """What is wrong with a recording while something else went on."""
    if status:
        return _unexplained(path, status, said)
    raw = read_run(path)
    samples = raw.streams["/imu"]
    rate = (samples.size - 1) / (float(samples["drain_after_ns"][-1] - samples["drain_after_ns"][0]) * 1e-9)
    full = abs(rate / configured(raw, "imu")["rate_hz"] - 1.0) < RATE_OFF
    full = full or samples["gap_before"].any()  # a gap that is marked is not silent
    sound = status == 0 and raw.complete and not raw.damage and full
    return "" if sound else f"status {status}, complete {raw.complete}, damage {raw.damage}, IMU {rate:.0f} Hz"


@contextmanager
def ready(folder: Path) -> Iterator[Path]:
    """The rig file of an emulated rig with patient limits, next to a plan; a first recording has been made."""
    with favoured(), served_rig(folder) as rig:
        text = re.sub(r"^(staleness_s|clock_bound_s) = .*\n", "", rig.read_text(), flags=re.MULTILINE)
        rig.write_text(text.replace("[limits]\n", PATIENT).replace("watchdog_ms = 500", "watchdog_ms = 1000"))
        write_plan(sine(PLAN_S, 0.3), folder / "plan.csv")
        with heard():
            legid(command_of(rig, folder / "first.mcap"))  # loads once what every fork would load
        yield rig


def page(kills: int = 1000, disturbed: int = 1000, minutes: float = 240.0, seed: int = 1) -> Lines:
    with new_folder() as folder, ready(folder) as rig:

        @kept
        def one(name: str, number: int, seed: int) -> Killed:
            found = {"kill_one": kill_one, "disturb_one": disturb_one}[name](rig, rig.parent, number, seed)
            for file in rig.parent.glob(f"{name}-{number}.*") if not found.fault else ():
                file.unlink()
            tell(name, number, found)
            return found

        killed, others = ([one(name, number, seed) for number in within(0.5 * minutes, range(count))]
                          for name, count in (("kill_one", kills), ("disturb_one", disturbed)))
    lost = [k.lost for k in killed if k.outcome.startswith("cut off")] or [0]
    faults = [k.fault for k in (*killed, *others) if k.fault]
    yield from [
        "# Recordings killed, and a second process at their devices",
        f"{len(killed)} and {len(others)} recordings: `legid record` on an emulated rig in a process of its own, over "
        "a port and a bus, in real time.", "## SIGKILL at any moment of a recording"]
    yield table("found afterwards | times", _counts(killed))
    yield from [
        f"{sum(not k.outcome.startswith('ended') for k in killed)} were killed while they ran. A file that was cut off "
        "holds every message that reached the system, "
        "reports its missing end, and recovers to a whole file. The recorder lost "
        f"{np.median(lost):.0f} messages in the median, {max(lost)} at most; it hands them over every "
        f"{FLUSH_MESSAGES}. A kill while the motor drives leaves the firmware's watchdog fault, which must be "
        "acknowledged. Recordings that ended themselves named a limit or a time-out.",
        "## A second process at the same devices, or at the file that is written"]
    yield table(" | times", _counts(others))
    yield from [
        "A first recording that did not end itself ended whole, with its IMU's rate. A stranger is a process that "
        "takes up to 64 samples from the IMU's FIFO and ignores locks. These samples are missing in the recording, and "
        "every reader of the run reports that.", *(f"- {fault}" for fault in faults)]
    return len(faults)


def _counts(found: Sequence[Killed]) -> list[tuple[str, int]]:
    """Outcomes, the most frequent first, and faults."""
    return [*Counter(k.outcome for k in found).most_common(), ("faults", sum(bool(k.fault) for k in found))]


EVIDENCE = Evidence(
    "Recordings killed at any moment, and a second process at their devices", "make kills", "kills.md", 90,
    "no fault", (r"\d+ were killed while they ran", r"\| (faults) \| (\d+)",
                          r"lost \d+ messages in the median, \d+ at most"))
main = program(page)
