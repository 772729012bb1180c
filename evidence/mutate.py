"""Files broken in bytes and in structure through every reader: read, or refused in one line, and nothing else.

    python -m evidence mutate --files 100000

A fault is any exception but `InputError`, a numerical warning, more than 10 s of a processor or more than 1 GB. Every
file comes from the seed and its number alone: `--only mcap --first 4711 --files 1` makes that one again.
"""

import json
import math
import re
import resource
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from mcap.writer import CompressionType, Writer

from daq import load_rig, parse_rig
from daq.recording import Plan, read_plan
from daq.runs import RunWriter, read_run, recover
from daq.runs.mcap_scan import Scan
from evidence.frame import Lines, program, table, tell, within
from evidence.kept import kept
from evidence.mutate_foreign import Make, foreign, some
from evidence.mutate_worker import Fault, Kind, study, used_s
from evidence.registry import Evidence
from experiments.judge import model_of
from experiments.models import load_model, mechanism_settings
from experiments.reports import describe_mcap
from tests.support.fits import synthetic_fit
from tests.support.paths import DEMO_RIG
from tests.support.runs import load_run

CHUNK = 1000
"""Files after which what was found is kept."""
MEMORY = Path("/dev/shm")
NAMES = {"rig": "rig.toml", "plan": "plans", "csv": "CSV runs", "mcap": "MCAP runs", "model": "models", "json": "JSON",
         "npz": "NumPy .npz", "mat": "MATLAB", "hdf5": "HDF5", "parquet": "Parquet", "text": "text tables",
         "can": "CAN logs", "db3": "ROS 2 bag, SQLite", "bag": "ROS 2 bag, MCAP", "urdf": "URDF", "mjcf": "MJCF",
         "map": "maps of columns"}
SAMPLES = 120
NUMBERS = [b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"9" * 400, b"1e400", b"true",
           b'"x"', b"[]", b"{}", b"null", b"", b"0x10", b"1_0", b"\xff", b"\x1b[2J", b"18446744073709551616"]
BRACKETS = [b"[", b"{", b"(", b'"', b",", b"\n", b"\0", b"[[", b'{"a":']


class Format(NamedTuple):
    """Whole files of one kind, and what reads them."""

    ending: str
    whole: list[bytes]
    read: Callable[[Path], object]
    make: Make | None = None
    """Makes a file that is broken in structure; every second file of the study is one."""


def leg_run(path: Path) -> bytes:
    """A short run with everything that an alignment needs."""
    imu = {"gyro_radps_per_lsb": 3e-4, "accel_mps2_per_lsb": 1.2e-3, "rate_hz": 238.0}
    writer = RunWriter(path, {"rig.toml": DEMO_RIG.read_text(), "plan.csv": "time_s,tau2_cmd_nm\n0,0\n1,0\n"})
    writer.config(0, "imu", json.dumps(imu))
    for k in range(SAMPLES):
        at, tick = 10**9 + k * 10_000_000, k * 10_000
        writer.add("/leg/telemetry", at, at, 0.1 * np.sin(k / 9), 0.05, 0.0, 0.2, 24.0, 30.0, 0.1, tick, 7, k, 0, 1)
        writer.add("/leg/clock", at, at, at + 200_000, tick + 90, tick + 100, 7, k)
        for i in (2 * k, 2 * k + 1):
            writer.add("/imu", at, at, at + 90_000, i, 1, 2, i % 50, 3, 8000, 5, 0)
    writer.event(10**9, "start", "armed")
    writer.close()
    return path.read_bytes()


def rewritten(path: Path, compression: CompressionType) -> bytes:
    """The same records without check sums, so that what is broken gets through to those who read them."""
    scan, out = Scan(path), path.with_suffix(".other")
    with out.open("wb") as file:
        writer: Any = Writer(file, compression=compression, chunk_size=8192, enable_crcs=False)
        writer.start()
        channels: dict[int, int] = {}
        record: Any
        for record in scan:
            match type(record).__name__:
                case "Channel" if record.id not in channels:
                    schema = writer.register_schema("x", "ros2msg", b"")
                    channels[record.id] = writer.register_channel(record.topic, "cdr", schema)
                case "Message":
                    writer.add_message(channels[record.channel_id], record.log_time, record.data, record.publish_time)
                case "Attachment":
                    writer.add_attachment(0, 0, record.name, "text/plain", record.data)
        writer.finish()
    return out.read_bytes()


def formats(folder: Path) -> dict[str, Format]:
    """All formats, with the files that are broken."""
    rig = parse_rig(DEMO_RIG.read_text())
    t = np.arange(SAMPLES) / 100.0
    plan = Plan(t, np.sin(t)).text().encode()
    names = "time_s,q1_rad,q2_rad,tau2_nm,gyro_radps,accel_x_mps2,accel_y_mps2,mine"
    csv = "\n".join([names, *(f"{x:.2f}," + ",".join(f"{np.sin(x + c):.6g}" for c in range(7)) for x in t)]).encode()
    run = leg_run(folder / "whole.mcap")
    runs = [run, *(rewritten(folder / "whole.mcap", kind) for kind in CompressionType)]
    model = msgspec.json.format(msgspec.json.encode(
        model_of(synthetic_fit(), mechanism_settings(rig), "zero", ["a.csv"])), indent=1)

    def read_mcap(path: Path) -> None:
        describe_mcap(read_run(path))
        saved = path.with_suffix(".saved")
        saved.unlink(missing_ok=True)
        recover(path, saved)
        load_run(path, rig)

    return {"rig": Format(".toml", [DEMO_RIG.read_bytes()], load_rig), "plan": Format(".csv", [plan], read_plan),
            "csv": Format(".csv", [csv], lambda path: load_run(path, rig)),
            "mcap": Format(".mcap", runs, read_mcap), "model": Format(".json", [model], load_model),
            **{name: Format(*parts) for name, parts in foreign(folder).items()}}


def put(kind: Format, seed: int, number: int, path: Path) -> None:
    """Write the file of a number."""
    rng = np.random.default_rng((seed, number))
    if kind.make is None or number % 2:
        path.write_bytes(broken(kind.whole[rng.integers(len(kind.whole))], rng))
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind.make(rng, path)


def broken(whole: bytes, rng: np.random.Generator) -> bytes:
    """`whole` with one fault, or with up to four."""
    data = bytearray(whole)
    for _ in range(1 if rng.random() < 0.6 else rng.integers(2, 5)):
        if not data:
            break
        a = int(rng.integers(len(data)))
        b = min(len(data), a + some(rng, 10))
        match rng.integers(9):
            case 0:
                data[a] ^= 1 << rng.integers(8)
            case 1:
                data[a:b] = rng.bytes(b - a)
            case 2:
                del data[a:b]
            case 3:
                data[b:b] = data[a:b] * rng.integers(1, 4)
            case 4:
                del data[a:]
            case 5:  # a field of a length or a count
                data[a: a + 8] = some(rng, 64).to_bytes(9, "little")[:8]
            case 6:  # a number in a text
                found = list(re.finditer(rb"-?\d[\d.eE+-]*", bytes(data[a: a + 400])))
                if found:
                    hit = found[rng.integers(len(found))]
                    data[a + hit.start(): a + hit.end()] = NUMBERS[rng.integers(len(NUMBERS))]
            case 7:
                data[a:a] = BRACKETS[rng.integers(len(BRACKETS))] * some(rng, 17)
            case 8:
                other = int(rng.integers(len(data)))
                data[a:b], data[other: other + b - a] = data[other: other + b - a], data[a:b]
    return bytes(data)


EVIDENCE = Evidence(
    "Broken files of 17 formats through their readers", "make mutate", "fuzz.md", 90,
    "read, or refused in one line", (r"These [\d,]+ files have \d+ faults",), r"with seed (3)",
    r"seed 3 on (\d{4}-\d\d-\d\d)")


def page(files: int = 100_000, first: int = 0, seed: int = 1, minutes: float = math.inf, chunk: int = CHUNK,
         only: Sequence[str] = ()) -> Lines:
    """`files` of each format in turns of a `chunk`, each format for the same time."""
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as place:
        kinds = formats(Path(place))

        @kept
        def some(name: str, first: int, files: int, seed: int) -> tuple[Counter[str], list[Fault], float]:
            began = used_s()
            kind = Kind(name, Path(place) / f"broken{kinds[name].ending}",
                        lambda number, path: put(kinds[name], seed, number, path), kinds[name].read)
            found = study(kind, first, files)
            return *found, used_s() - began

        counts = {name: Counter[str]() for name in only or kinds}
        faults, took_s = {name: list[Fault]() for name in counts}, dict.fromkeys(counts, 0.0)
        turns = iter(lambda: min((name for name in counts if counts[name]["files"] < files), key=took_s.__getitem__,
                                 default=""), "")
        for name in within(minutes, turns):
            done = counts[name]["files"]
            size = min(chunk, files - done)
            more, bad, used = some(name, first + done, size, seed)
            worst = max(counts[name]["worst_ms"], more["worst_ms"])
            counts[name] += more + Counter(files=size)
            counts[name]["worst_ms"] = worst
            faults[name] += bad
            took_s[name] += used
            tell(name, done + size, *bad)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    every = sum(map(len, faults.values()))
    yield "# Broken files through every reader"
    yield table("format | files | read | refused | stopped | faults | slowest | files a second", (
        f"{NAMES.get(name, name)} | {one['files']:,} | {one['read']:,} | {one['refused']:,} | {one['stopped']:,} | "
        f"{len(faults[name])} | "
        + (f"{one['worst_ms'] / 1e3:.1f} s" if one["worst_ms"] > 999 else f"{one['worst_ms']} ms")
        + f" | {one['files'] / max(took_s[name], 1e-9):.0f}" for name, one in counts.items()))
    yield (f"These {sum(one['files'] for one in counts.values()):,} files have {every} faults. They took "
           f"{sum(took_s.values()) / 60:.0f} minutes of a processor, and at most {peak:.0f} MB in a process that "
           "reads.")
    return every


main = program(page)
