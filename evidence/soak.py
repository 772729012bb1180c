"""Long recordings and many kills: what a recorder must survive, measured.

    python -m evidence soak --out docs/evidence/soak.md        # what `make soak` does
"""

import mmap
import os
import signal
import struct
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq.recording import QueuedSink
from daq.runs import read_run, recover
from daq.runs.mcap_run import FLUSH_MESSAGES
from evidence import clock_laws, fuzz_codecs
from evidence.frame import Lines, new_folder, program
from evidence.registry import Evidence
from evidence.rigs import losses, record_real, record_virtual
from tests.support.c_firmware import Served

PROGRESS = struct.Struct("<QQ")  # messages handed over, host time of the last [ns]
TIME = struct.Struct("<Q")
KEPT = 4096
"""Of the last times, behind the progress."""


def place_of(message: int) -> int:
    return PROGRESS.size + TIME.size * (message % KEPT)


def soak_virtual(folder: Path, seconds: float) -> dict[str, int]:
    """What a recording on virtual time lost."""
    record_virtual(folder / "virtual.mcap", seconds)
    return losses(read_run(folder / "virtual.mcap"))


def soak_real(folder: Path, seconds: float) -> tuple[dict[str, int], float]:
    """What a recording on the real clock lost, and its process's share of one core."""
    served = Served(1000)
    try:
        cpu, wall = time.process_time(), time.monotonic()
        record_real(folder / "real.mcap", served.path, seconds)
        share = (time.process_time() - cpu) / (time.monotonic() - wall)
    finally:
        served.close()
    return losses(read_run(folder / "real.mcap")), share


class Killed(NamedTuple):
    """One recording that was killed."""

    handed_over: int
    recovered: int
    oldest_missing_s: float
    """How long before the kill the oldest message that is missing had been handed over; 0 with none missing."""
    whole: bool
    """The recovered file reads as complete, and its messages are a beginning of what was handed over."""

    @property
    def good(self) -> bool:
        """Nothing older than a flush or 1 s is missing."""
        missing = self.handed_over - self.recovered
        return self.whole and (missing <= FLUSH_MESSAGES or self.oldest_missing_s <= 1.0)


def record_and_note(path: Path, port: str, progress: mmap.mmap) -> None:
    """Record for a minute; every message handed over is counted where the parent can read it after the kill."""
    times, put = [], QueuedSink.add

    def add(self: QueuedSink, topic: str, host_ns: int, *values: float, sequence: int = 0) -> None:
        put(self, topic, host_ns, *values, sequence=sequence)
        times.append(time.monotonic_ns())
        at = len(times)
        TIME.pack_into(progress, place_of(at), times[-1])
        PROGRESS.pack_into(progress, 0, at, times[-1])

    QueuedSink.add = add  # type: ignore[method-assign]
    record_real(path, port, 60.0)


def kill_one(folder: Path, k: int, port: str, rng: np.random.Generator) -> Killed:
    """Fork a recorder, kill it at a random time, recover its file."""
    path = folder / f"k{k}.mcap"
    progress = mmap.mmap(-1, PROGRESS.size + TIME.size * KEPT)
    child = os.fork()
    if child == 0:
        try:
            record_and_note(path, port, progress)
        finally:
            os._exit(1)
    deadline = time.monotonic() + 30
    while PROGRESS.unpack_from(progress)[0] < 1 and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(rng.uniform(0.02, 2.5))
    os.kill(child, signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    os.waitpid(child, 0)
    handed, _ = PROGRESS.unpack_from(progress)
    out = path.with_suffix(".recovered.mcap")
    report = recover(path, out)
    raw = read_run(out)
    streams = sum(map(len, raw.streams.values()))
    oldest = 0.0
    if streams < handed:
        oldest = (killed_ns - TIME.unpack_from(progress, place_of(streams + 1))[0]) * 1e-9
    found = losses(raw)
    whole = raw.complete and report.messages == raw.messages and not (
        found["imu_doubled"] or found["frames_doubled"] or found["imu_torn"])
    path.unlink()
    out.unlink()
    return Killed(handed, streams, oldest, whole)


def kill_many(folder: Path, count: int, seed: int) -> list[Killed]:
    """Recordings killed one after the other. The firmware, a process of its own, goes on through all of them."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        served = Served(1000)
        try:
            out.append(kill_one(folder, k, served.path, rng))
        finally:
            served.close()
    return out


def page(virtual: float = 600.0, real: float = 60.0, kills: int = 200, frames: int = 1_000_000, runs: int = 1000,
         seed: int = 1) -> Lines:
    yield from ["# Soak, fuzz and clock studies",
                "The devices are emulated: an LSM9DS1 at 952 Hz and a controller at 1 kHz."]
    with new_folder() as folder:
        yield from [f"## {virtual:g} s on virtual time", _losses(soak_virtual(folder, virtual))]
        found, share = soak_real(folder, real)
        yield from [f"## {real:g} s on the real clock",
                    _losses(found), f"The recording process took {share:.1%} of one core (the controller is "
                    "another process, the chip's bus is in memory).",
                    f"## {kills} SIGKILLs at random times of a recording",
                    _kills(kill_many(folder, kills, seed))]
    for lines in (fuzz_codecs.page(frames, seed), clock_laws.page(runs, seed)):
        yield from (f"#{line}" if line.startswith("# ") else line for line in lines)


def _kills(kills: list[Killed]) -> str:
    missing = [k.handed_over - k.recovered for k in kills]
    oldest = max(k.oldest_missing_s for k in kills)
    return (f"{sum(k.whole for k in kills)} files recovered whole; messages missing at the end: at most "
            f"{max(missing)}, median {int(np.median(missing))}; the oldest of them had been handed over {oldest:.2f} s "
            f"before the kill. Beyond {FLUSH_MESSAGES} messages and 1 s: {sum(not k.good for k in kills)} files.")


def _losses(found: dict[str, int]) -> str:
    return (f"{found['imu_samples']} IMU samples: {found['imu_lost']} lost, {found['imu_doubled']} doubled, "
            f"{found['imu_gaps_marked']} gaps marked. {found['frames']} telemetry frames: {found['frames_lost']} lost, "
            f"{found['frames_doubled']} doubled.")


EVIDENCE = Evidence(
    "Long recordings, kills, broken frames and the controller's clock", "make soak", "soak.md", 13,
    "no sample lost, no file lost, at most 250 messages missing after a kill",
    (r"\d+ IMU samples: \d+ lost", r"\d+ files recovered whole", r"Beyond \d+ messages and 1 s: \d+ files"),
    resumes="no: a soak is one recording")
main = program(page)
