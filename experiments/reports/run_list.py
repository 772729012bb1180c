"""Recorded runs of a folder, one line each, with the verdict of the newest diagnosis that used them."""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from daq import InputError, read_bytes
from daq.runs import SUFFIXES, RawRun, commanded, read_csv, read_run, start_of
from daq.timing import find_clock_faults, recorded_rig
from experiments.console import progress, text_table
from experiments.judge import BOUND_S, clock_bound_s
from experiments.reports.run_info import lost_frames, readings_of, recorded_readings

KINDS = (".mcap", *SUFFIXES)
MOST_HEADER = 1 << 16
"""Bytes of a CSV's header that are looked at."""
MOST_BYTES = 1 << 26
"""Of a JSON that is looked into."""
RAIL_COUNTS = 32760
"""Of 16 bits: from here on a reading is at its rail."""


class _Cause(Struct):
    effect: str
    joint: int | None = None


class _Diagnosis(Struct, tag_field="schema", tag="legid.diagnosis/1"):
    """What is read of a diagnosis JSON; everything else in it is left alone."""

    verdict: str
    causes: tuple[_Cause, ...] = ()
    runs: dict[str, tuple[str, ...]] = {}


@dataclass(frozen=True)
class RunLine:
    """One run file. What could not be read is None."""

    file: str
    """Path below the folder listed."""
    recorded: datetime | None = None
    seconds: float = 0.0
    model: str | None = None
    clock_bound_s: float | None = None
    frames_lost: int = 0
    imu_gaps: int = 0
    clipped: int = 0
    """IMU samples with an axis at its rail: the true reading is beyond."""
    readings: tuple[str, ...] = ()
    """Readings that no device can give, in sentences."""
    clock_faults: tuple[str, ...] = ()
    """Steps, freezes and rate changes of the controller's clock."""
    ended: str = ""
    """Why the run ended early, or what is missing of its file; empty if nothing is known."""
    verdict: str | None = None
    causes: tuple[str, ...] = ()
    """`effect@joint` of that verdict."""
    diagnosis: str | None = None
    """File of that verdict."""
    follows: str = ""
    """Commands that its joints follow, where it has no torque of them."""

    @property
    def faulty(self) -> bool:
        """Something was lost, or it ended early."""
        return bool(self.frames_lost or self.imu_gaps or self.clock_faults or self.ended or self.readings)

    @property
    def flaws(self) -> tuple[str, ...]:
        """Why a fit had better do without it, each in a few words; empty for a sound run."""
        bound = self.clock_bound_s
        return tuple(words for words, bad in (
            (f"ended early: {self.ended}", self.ended),
            (f"{self.imu_gaps} gaps of the IMU", self.imu_gaps),
            (f"{self.frames_lost} frames lost", self.frames_lost),
            (f"{self.clipped} IMU samples at their rail", self.clipped),
            (f"faults of the controller's clock: {'; '.join(self.clock_faults)}", self.clock_faults),
            (f"faults of readings: {'; '.join(self.readings)}", self.readings),
            (f"clock known to {(bound or 0.0) * 1e3:.1f} ms only", bound is not None and bound > BOUND_S)) if bad)


def list_runs(folder: Path | str) -> list[RunLine]:
    """All .mcap files in `folder` and below, oldest first, then runs as CSV, or that one file. Raises `InputError`
    where there is none of that name."""
    folder = Path(folder)
    if folder.name.lower().endswith(KINDS) and folder.is_file():
        return [_with_verdict(_line(folder, folder.parent), folder, _documents(folder.parent))]
    if not folder.is_dir():
        raise InputError(str(folder), "is no folder", "name one that holds run files")
    documents = _documents(folder)
    paths = sorted(path for path in folder.rglob("*")
                   if path.name.lower().endswith(KINDS) and (path.suffix == ".mcap" or holds_run(path)))
    lines = [_with_verdict(_line(path, folder), path, documents)
             for path in progress(paths, "reading runs", unit="run")]
    return sorted(lines, key=lambda line: (line.recorded is None, line.recorded or datetime.max.replace(tzinfo=UTC)))


def other_tables(folder: Path | str) -> list[Path]:
    """The CSV files in `folder` and below that are neither runs nor plans, by their header."""
    tables = sorted(Path(folder).rglob("*.csv")) if Path(folder).is_dir() else []
    return [path for path in tables if (names := _header(path)) and "time_s" not in names]


def choose(lines: Iterable[RunLine], model: str | None = None, since: date | None = None, until: date | None = None,
           verdict: str | None = None, faulty: bool = False) -> list[RunLine]:
    """Those of that rig model, recorded (UTC) on these days, with that verdict (`-`: none yet), faulty ones only."""
    return [line for line in lines
            if (model is None or line.model == model)
            and (since is None or (line.recorded is not None and line.recorded.date() >= since))
            and (until is None or (line.recorded is not None and line.recorded.date() <= until))
            and (verdict is None or (line.verdict or "-") == verdict)
            and (not faulty or line.faulty)]


def runs_text(lines: Sequence[RunLine]) -> str:
    """The list for a terminal."""
    rows = [[line.file, f"{line.recorded:%Y-%m-%d %H:%M:%S}" if line.recorded else "-", f"{line.seconds:.1f}",
             line.model or "-", "-" if line.clock_bound_s is None else f"{line.clock_bound_s * 1e6:.0f}",
             str(line.frames_lost), str(line.imu_gaps), str(line.clipped),
             " ".join([line.verdict or "-", *line.causes]),
             "; ".join(filter(None, [line.ended, "clock fault" * bool(line.clock_faults),
                                     "faulty readings" * bool(line.readings),
                                     f"follows {line.follows}" if line.follows else ""]))]
            for line in lines]
    return text_table(["run", "recorded [UTC]", "seconds", "rig", "clock [us]", "lost", "gaps", "clipped", "verdict",
                       "remark"], rows, right={2, 4, 5, 6, 7})


def runs_document(lines: Sequence[RunLine]) -> dict[str, Any]:
    """The same for programs."""
    return {"schema": "legid.runs/1",
            "runs": [{**msgspec.to_builtins(line), "flaws": list(line.flaws)} for line in lines]}


def _line(path: Path, folder: Path) -> RunLine:
    name = str(path.relative_to(folder))
    if path.suffix != ".mcap":
        return _csv_line(path, name)
    try:
        raw = read_run(path)
    except (InputError, OSError) as error:
        return RunLine(name, ended=f"not readable: {getattr(error, 'what', error)}")
    telemetry, probes = raw.streams["/leg/telemetry"], raw.streams["/leg/clock"]
    seconds = float(telemetry["host_ns"][-1] - telemetry["host_ns"][0]) * 1e-9 if telemetry.size else 0.0
    return RunLine(
        name, start_of(raw.facts), seconds, _model(raw),
        clock_bound_s(raw) if probes.size else None, lost_frames(telemetry) if telemetry.size else 0,
        int(raw.streams["/imu"]["gap_before"].sum()), _clipped(raw), tuple(recorded_readings(raw)),
        tuple(find_clock_faults(raw)), _ended(raw))


def holds_run(path: Path) -> bool:
    """Whether a CSV's header names the columns of a run, and not of a plan or of another program."""
    names = _header(path)
    return "time_s" in names and any(re.match(r"q\d+_(rad|m)$|gyro", name) for name in names)


def _header(path: Path) -> list[str]:
    """Names in the first line of a CSV; empty where it cannot be read."""
    try:
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
            return [cell.strip() for cell in file.readline(MOST_HEADER).split(",")]
    except (OSError, EOFError, zlib.error, UnicodeDecodeError):
        return []


def _csv_line(path: Path, name: str) -> RunLine:
    try:
        table = read_csv(path)
    except InputError as error:
        return RunLine(name, ended=f"not readable: {error.what}")
    follows = ", ".join(f"q{j}_cmd_rad" for j in commanded(list(table.columns)))
    return RunLine(name, seconds=float(table.time_s[-1] - table.time_s[0]), readings=tuple(readings_of(table)),
                   follows=follows)


def _clipped(raw: RawRun) -> int:
    imu = raw.streams["/imu"]
    axes = [imu[f"{kind}_{axis}"].astype(np.int32) for kind in ("gyro", "accel") for axis in "xyz"]
    return int((np.abs(axes).max(axis=0) >= RAIL_COUNTS).sum()) if imu.size else 0


def _model(raw: RawRun) -> str | None:
    try:
        return recorded_rig(raw).mechanism.model
    except InputError:
        return None


def _ended(raw: RawRun) -> str:
    early = [note.text if note.kind == "abort" else note.kind for note in raw.events
             if note.kind == "abort" or note.kind.startswith("limit ")]
    if early:
        return early[-1].split(";")[0]
    if not raw.complete:
        return "file cut off"
    return f"damaged: {'; '.join(map(str, raw.damage))}" if raw.damage else ""


def _documents(folder: Path) -> list[tuple[Path, _Diagnosis]]:
    """JSONs of diagnoses below the folder, newest first."""
    found: list[tuple[float, Path, _Diagnosis]] = []
    for path in folder.rglob("*.json"):
        try:
            document = msgspec.json.decode(read_bytes(path, MOST_BYTES), type=_Diagnosis)
        except (msgspec.DecodeError, UnicodeDecodeError, OSError, RecursionError, InputError):
            continue
        found.append((path.stat().st_mtime, path, document))
    return [(path, document) for _, path, document in sorted(found, key=lambda entry: entry[0], reverse=True)]


def _with_verdict(line: RunLine, path: Path, documents: Sequence[tuple[Path, _Diagnosis]]) -> RunLine:
    """`line` with what the newest diagnosis in the run's own folder says of it: another folder's run of that name is
    another."""
    for where, document in documents:
        if where.parent == path.parent and any(path.name in group for group in document.runs.values()):
            causes = tuple(c.effect if c.joint is None else f"{c.effect}@{c.joint}" for c in document.causes)
            return replace(line, verdict=document.verdict, causes=causes, diagnosis=where.name)
    return line
