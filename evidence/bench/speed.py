"""Times the default fit of a leg beside its peers and prints ratios, growth, memory and the distance to the floor.

    python -m evidence bench.speed [--page] [--samples 500,2000,10000,60000] [--limit SECONDS] [--peers NAME,...]
                                [--kept FILE]

Every peer runs in a process of its own, one at a time, and is stopped after the limit. What it found is kept in FILE at
once, and taken from there by the next call on the same machine and day: an interrupted bench goes on where it stopped.
Of the paper's recipe one evaluation is timed first; where a single step would pass the limit it is not begun.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from evidence.bench.peer import PEERS
from evidence.bench.record import RATE_HZ, SEED, write_record
from evidence.registry import Evidence
from tests.support.paths import ROOT

SAMPLES = (500, 2000, 5000, 6000, 10000, 60000)
TITLES = {"legid": "legid, whole fit", "casadi": "CasADi with IPOPT", "mujoco": "MuJoCo sysid",
          "mujoco-2ms": "MuJoCo sysid, its default step",
          "free": "legid `--latent free`", "paper": "the paper's recipe"}
TYPED = "typed_s"
"""Of the whole process: legid's command from a file, another's script from its first import."""
Table = dict[tuple[str, int], dict[str, Any]]


class Kept:
    """What peers found on this machine today, in a file of JSON lines."""

    def __init__(self, path: Path) -> None:
        self.path, self.found = path, Table()
        self.mark = [datetime.date.today().isoformat(), machine()]
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        for entry in map(json.loads, lines):
            if entry["mark"] == self.mark:
                self.found[entry["peer"], entry["samples"]] = entry["found"]

    def add(self, peer: str, samples: int, found: dict[str, Any]) -> None:
        """Keep what `peer` found."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"mark": self.mark, "peer": peer, "samples": samples, "found": found}) + "\n")


def ask(peer: str, record: Path, samples: int, limit: float) -> dict[str, Any]:
    """What the peer found, or why it found nothing, with what it had said before."""
    command = [sys.executable, "-m", "evidence", "bench.peer", peer, str(record), str(samples), str(limit)]
    told: dict[str, Any] = {}
    clock, before = time.perf_counter(), os.times()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            out, err = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
            told["failed"] = f"not done after {limit:.0f} s"
    for line in out.splitlines():
        told |= json.loads(line)
    busy = sum(os.times()[2:4]) - sum(before[2:4])  # of children that have ended
    told.setdefault(TYPED, min(time.perf_counter() - clock, busy))
    if "seconds" not in told and "failed" not in told:
        told["failed"] = (err.strip().splitlines() or ["no output"])[-1]
    return told


def measure(record: Path, lengths: list[int], peers: list[str], limit: float, kept: Kept) -> Table:
    """All peers on all lengths, but for what is `kept`; one that did not end on a length is not asked for longer
    ones."""
    found: Table = {}
    for peer in peers:
        for samples in sorted(lengths):
            if (peer, samples) in kept.found:
                found[peer, samples] = kept.found[peer, samples]
            else:
                found[peer, samples] = ask(peer, record, samples, limit)
                kept.add(peer, samples, found[peer, samples])
            print(f"{TITLES[peer]}, {samples}: {cell(found[peer, samples])}", file=sys.stderr, flush=True)
            if "failed" in found[peer, samples]:
                break
    return found


def cell(entry: dict[str, Any] | None) -> str:
    """Seconds, or why there are none."""
    if entry is None:
        return "not tried"
    if "failed" in entry:
        step = f"; one step of it: {entry['step_s']:,.0f} s, projected" if "step_s" in entry else ""
        return entry["failed"] + step
    if "solve_s" in entry:
        return f"{entry['build_s']:.2f} + {entry['solve_s']:.2f}"
    return f"{entry['seconds']:.3f}"


def exponent(found: Table, lengths: list[int]) -> float:
    """Of growth between the shortest and longest length that legid was asked for."""
    first, last = min(lengths), max(lengths)
    return float(np.log(found["legid", last]["seconds"] / found["legid", first]["seconds"]) / np.log(last / first))


def ratio(found: Table, peer: str, samples: int, key: str = "seconds") -> str:
    """How many times legid's seconds a peer takes."""
    entry = found.get((peer, samples), {})
    return f"{entry[key] / found['legid', samples]['seconds']:.0f}" if key in entry else "-"


def tables(found: Table, lengths: list[int], peers: list[str]) -> str:
    """What was measured, as Markdown."""
    head = "| | " + " | ".join(f"{n:,} samples" for n in lengths) + " |\n| --- |" + " ---: |" * len(lengths)
    lines = ["Seconds, on the clock or of the processor, whichever are fewer (CasADi: build + solve):", "", head]
    for peer in peers:
        lines.append(f"| {TITLES[peer]} | " + " | ".join(cell(found.get((peer, n))) for n in lengths) + " |")
        if peer == "legid":
            for title, key in (("the first fit of a process", "first_s"), ("`legid fit`, the whole command", TYPED)):
                lines.append(f"| {title} | " + " | ".join(f"{found[peer, n][key]:.3f}" for n in lengths) + " |")
    if "legid" not in peers:
        return "\n".join(lines)
    lines += ["", "Times legid's whole fit:", "", head]
    for peer in peers[1:]:
        lines.append(f"| {TITLES[peer]} | " + " | ".join(ratio(found, peer, n) for n in lengths) + " |")
        if peer == "casadi":
            lines.append("| its solve alone | " + " | ".join(ratio(found, peer, n, "solve_s") for n in lengths) + " |")
    lines += ["", "legid against its own floor:", "", head]
    rows: tuple[tuple[str, Callable[[dict[str, Any], int], str]], ...] = (
            ("iterations", lambda e, n: f"{e['iterations']}"),
            ("one residual and Jacobian, ms", lambda e, n: f"{1e3 * e['evaluation_s']:.2f}"),
            ("the same, and its normal equations, ms", lambda e, n: f"{1e3 * e['linearise_s']:.2f}"),
            ("fit / (residual and Jacobian x iterations)",
             lambda e, n: f"{e['seconds'] / e['evaluation_s'] / e['iterations']:.1f}"),
            ("fit / (normal equations x iterations)",
             lambda e, n: f"{e['seconds'] / e['linearise_s'] / e['iterations']:.1f}"),
            ("microseconds a sample and iteration", lambda e, n: f"{1e6 * e['seconds'] / e['iterations'] / n:.2f}"),
            ("of that, residual and Jacobian", lambda e, n: f"{1e6 * e['evaluation_s'] / n:.2f}"),
            ("peak memory, MB", lambda e, n: f"{e['memory_mb']:.0f}"))
    for title, show in rows:
        lines.append(f"| {title} | " + " | ".join(show(found["legid", n], n) for n in lengths) + " |")
    if len(lengths) > 1:
        lines += ["", f"Exponent of growth from {min(lengths):,} to {max(lengths):,} samples: "
                      f"{exponent(found, lengths):.2f}."]
    if {6000, 60000} <= set(lengths):
        by, typed = (found["legid", 60000][key] / found["legid", 6000][key] for key in ("seconds", TYPED))
        lines.append(f"60,000 samples take {by:.1f} times what 6,000 take, as typed {typed:.1f} times.")
    return "\n".join(lines)


BEYOND = """\
Residuals and Jacobian are the floor of a fit. Each step also sums the normal equations, eliminates the motion and
updates noise levels. The steps on an excerpt, the filters of the start and the test of excitation come on top. In short
records most of the time goes into calls, not arithmetic."""


def asked(found: Table) -> str:
    """What was asked of the fit, and what this run shows, as Markdown; of what was measured only."""
    rows: list[tuple[str, float, float, str, str]] = []

    def times(title: str, peer: str, samples: int, least: float, key: str = "seconds") -> None:
        entry, own = found.get((peer, samples), {}), found.get(("legid", samples), {})
        if key in entry and "seconds" in own:
            rows.append((title, entry[key] / own["seconds"], least, "at least", " times"))

    times("faster than CasADi with IPOPT, 2,000 samples", "casadi", 2000, 30)
    times("faster than its solve alone, 2,000 samples", "casadi", 2000, 3, "solve_s")
    times("faster than MuJoCo sysid at the record's rate, 5,000 samples", "mujoco", 5000, 50)
    times("faster than MuJoCo sysid at its default step, 5,000 samples", "mujoco-2ms", 5000, 50)
    for title, peer, least in (("CasADi with IPOPT", "casadi", 10), ("MuJoCo sysid", "mujoco", 5)):
        if "seconds" in found.get((peer, 2000), {}) and ("legid", 2000) in found:
            by = found[peer, 2000][TYPED] / found["legid", 2000][TYPED]
            rows.append((f"as typed, 2,000 samples, against {title} as a script", by, least, "at least", " times"))
    own = {n: e for (peer, n), e in found.items() if peer == "legid" and "seconds" in e}
    if len(own) > 1:
        rows.append(("exponent of growth", exponent(found, list(own)), 1.05, "at most", ""))
    floors = [e["seconds"] / e["evaluation_s"] / e["iterations"] for e in own.values()]
    if floors:
        rows.append(("fit over its floor, the worst of all lengths", max(floors), 2.5, "at most", " times"))
    if 2000 in own:
        rows.append(("`legid fit` of 2,000 samples, as typed", own[2000][TYPED], 0.7, "at most", " s"))
    if {6000, 60000} <= set(own):
        growth = own[60000][TYPED] / own[6000][TYPED]
        rows.append(("60,000 samples over 6,000, as typed", growth, 11, "at most", " times"))
    if 60000 in own:
        rows.append(("peak memory at 60,000 samples", own[60000]["memory_mb"], 500, "at most", " MB"))
    lines = ["| | asked | measured | |", "| --- | ---: | ---: | --- |"]
    for title, value, bound, sense, unit in rows:
        met = value >= bound if sense == "at least" else value <= bound
        lines.append(f"| {title} | {sense} {bound:g}{unit} | {value:.3g}{unit} | {'met' if met else 'missed'} |")
    lines += ["", BEYOND]
    if 5000 in own and "seconds" in found.get(("mujoco", 5000), {}):
        share = 1e6 * found["mujoco", 5000]["seconds"] / 50 / (5000 * own[5000]["iterations"])
        lines.append("MuJoCo sysid fits eight parameters to a free run, but neither motion nor noise levels.\n"
                     f"A fiftieth of its time is {share:.2f} us for each sample and step of the fit. Residual and "
                     f"Jacobian take {1e6 * own[5000]['evaluation_s'] / 5000:.2f} us.")
    return "\n".join(lines)


def machine() -> str:
    """What the figures were measured on."""
    try:
        names = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                 if line.startswith("model name")]
    except OSError:
        names = []
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba", "casadi", "mujoco"))
    return (f"{os.cpu_count()} cores, {names[0] if names else platform.machine()}, Python {platform.python_version()}, "
            f"{packages}, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'not set')}")


PAGE = """# Speed of the default fit, {date}

Written by `make bench`. A leg with IMU and knee encoder, simulated by MuJoCo (seed {seed}, {rate:.0f} Hz); shorter
records are the beginning of the longest. Each peer ran alone in its own process, at most {limit:.0f} s.

Machine: {machine}.
Load average at the start {before:.1f}, at the end {after:.1f}. Other work on the machine slows everything down, though
not everything alike.

{tables}

Asked, and measured in this run:

{asked}

What is compared:

- **legid** estimates parameters, motion, noise levels and covariance. Best of several runs in one process. The first
  fit of a process loads the compiled kernels. "As typed" is the command on a CSV file, with the start of Python, the
  best of five. Iterations are those on the whole record; the time includes those on an excerpt.
- **CasADi with IPOPT** solves the same sum of squares from the same start, with given noise levels
  (`evidence/bench/casadi_ipopt.py`).
- **MuJoCo sysid** fits a free run to the sensors, with exact torque, given masses, a length and the first state. It
  runs at the record's rate, its cheapest, and in MuJoCo's default steps of 2 ms
  (`evidence/bench/mujoco_sysid.py`).
- **legid `--latent free`** is the paper's free latents with exact sparse derivatives. **The paper's recipe** takes them
  numerically, as (51) says (`evidence/bench/paper.py`).
"""


EVIDENCE = (
    Evidence("Speed of the default fit against CasADi with IPOPT and MuJoCo sysid", "make bench", "bench.md", 15,
             "30 times CasADi with IPOPT at 2,000 samples, 50 times MuJoCo sysid at 5,000",
             (r"(faster than CasADi with IPOPT, 2,000 samples) \|[^|]*\| (\S+ times)",
              r"(faster than MuJoCo sysid at the record's rate, 5,000 samples) \|[^|]*\| (\S+ times)"), r"seed (\d+)",
             resumes="no: all times are of one load"),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="store_true", help="write docs/evidence/bench.md too")
    parser.add_argument("--samples", default=",".join(map(str, SAMPLES)), help="lengths of the record")
    parser.add_argument("--limit", type=float, default=600.0, help="most seconds for a peer on one length")
    parser.add_argument("--kept", type=Path, default=Path("build/bench.jsonl"), help="what peers found so far")
    parser.add_argument("--peers", default=",".join(PEERS), help="of " + ", ".join(PEERS))
    args = parser.parse_args(arguments)
    lengths, peers = sorted(map(int, args.samples.split(","))), args.peers.split(",")
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as directory:
        record = Path(directory) / "record.npz"
        write_record(record, max(lengths))
        found = measure(record, lengths, peers, args.limit, Kept(args.kept))
    text = tables(found, lengths, peers)
    print(text)
    if args.page:
        date = datetime.date.today().isoformat()
        page = ROOT / "docs/evidence/bench.md"
        page.write_text(PAGE.format(date=date, seed=SEED, rate=RATE_HZ, limit=args.limit, machine=machine(),
                                    before=before, after=os.getloadavg()[0], tables=text,
                                    asked=asked(found)), encoding="utf-8")
        print(f"written to {page}", file=sys.stderr)
