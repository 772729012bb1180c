"""`make bench`: times the default fit of a leg beside its peers, its growth, memory and distance to the floor.

Every peer runs in a process of its own, one at a time, and is stopped after the limit. What it found is taken by the
next call on the same machine and day: an interrupted bench goes on where it stopped.
Of the paper's recipe one evaluation is timed first; where a single step would pass the limit it is not begun.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from evidence.bench.peer import PEERS
from evidence.bench.record import RATE_HZ, SEED, write_record
from evidence.frame import Lines, new_folder, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence
from studies import machine

SAMPLES = (500, 2000, 5000, 6000, 10000, 60000)
TITLES = {"legid": "legid, whole fit", "casadi": "CasADi with IPOPT", "mujoco": "MuJoCo sysid",
          "mujoco-2ms": "MuJoCo sysid, its default step",
          "free": "legid `--latent free`", "paper": "the paper's recipe"}
TYPED = "typed_s"
"""Of the whole process: legid's command from a file, another's script from its first import."""
REPEATED = 6
"""Fits of legid in the time of one of another's: the best of several counts."""
Found = dict[str, Any]
"""By one peer on one length"""
Table = dict[tuple[str, int], Found]


def ask(peer: str, record: Path, samples: int, limit: float) -> Found:
    """What the peer found, or why it found nothing, with what it had said before."""
    command = [sys.executable, "-m", "evidence", "bench.peer", peer, str(record), str(samples), str(limit)]
    told: Found = {}
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


def measure(lengths: Sequence[int], peers: Sequence[str], limit: float) -> Table:
    """All peers on all lengths; one that did not end on a length is not asked for longer ones."""
    found: Table = {}
    with new_folder() as folder:
        record = folder / "record.npz"
        write_record(record, max(lengths))

        @kept
        def asked_today(peer: str, samples: int, limit: float, day: str, machine: str) -> Found:
            return ask(peer, record, samples, limit)

        for peer in peers:
            for samples in lengths:
                most = (REPEATED if peer == "legid" else 1) * limit
                one = asked_today(peer, samples, most, f"{datetime.now(UTC):%Y-%m-%d}", machine())
                found[peer, samples] = one
                tell(TITLES[peer], samples, cell(one))
                if "failed" in one:
                    break
    return found


def cell(entry: Found | None) -> str:
    """Seconds, or why there are none."""
    if entry is None:
        return "not tried"
    if "failed" in entry:
        step = f"; one step of it: {entry['step_s']:,.0f} s, projected" if "step_s" in entry else ""
        return entry["failed"] + step
    if "solve_s" in entry:
        return f"{entry['build_s']:.2f} + {entry['solve_s']:.2f}"
    return f"{entry['seconds']:.3f}"


def exponent(found: Table, lengths: Sequence[int]) -> float:
    """Of growth between the shortest and longest length that legid was asked for."""
    first, last = min(lengths), max(lengths)
    return float(np.log(found["legid", last]["seconds"] / found["legid", first]["seconds"]) / np.log(last / first))


def ratio(found: Table, peer: str, samples: int, key: str = "seconds") -> str:
    """How many times legid's seconds a peer takes."""
    entry = found.get((peer, samples), {})
    return f"{entry[key] / found['legid', samples]['seconds']:.0f}" if key in entry else "-"


FLOOR: dict[str, Callable[[Found, int], str]] = {
    "iterations": lambda e, n: f"{e['iterations']}",
    "one residual and Jacobian, ms": lambda e, n: f"{1e3 * e['evaluation_s']:.2f}",
    "the same, and its normal equations, ms": lambda e, n: f"{1e3 * e['linearise_s']:.2f}",
    "fit / (residual and Jacobian x iterations)":
        lambda e, n: f"{e['seconds'] / e['evaluation_s'] / e['iterations']:.1f}",
    "fit / (normal equations x iterations)": lambda e, n: f"{e['seconds'] / e['linearise_s'] / e['iterations']:.1f}",
    "microseconds a sample and iteration": lambda e, n: f"{1e6 * e['seconds'] / e['iterations'] / n:.2f}",
    "of that, residual and Jacobian": lambda e, n: f"{1e6 * e['evaluation_s'] / n:.2f}",
    "peak memory, MB": lambda e, n: f"{e['memory_mb']:.0f}"}


def tables(found: Table, lengths: Sequence[int], peers: Sequence[str]) -> Iterator[str]:
    """What was measured."""
    head = f" | {' | '.join(f'{n:,} samples' for n in lengths)}"
    rows = {TITLES[peer]: [cell(found.get((peer, n))) for n in lengths] for peer in peers}
    if "legid" in peers:
        rows |= {title: [f"{found['legid', n][key]:.3f}" for n in lengths] for title, key in (
            ("the first fit of a process", "first_s"), ("`legid fit`, the whole command", TYPED))}
    yield "Seconds, on the clock or of the processor, whichever are fewer (CasADi: build + solve):"
    yield table(head, ((title, *cells) for title, cells in rows.items()))
    if "legid" not in peers:
        return
    times = [(TITLES[peer], peer, "seconds") for peer in peers[1:]]
    times += [("CasADi's solve alone", "casadi", "solve_s")] * ("casadi" in peers)
    yield "Times legid's whole fit:"
    yield table(head, ((title, *(ratio(found, peer, n, key) for n in lengths)) for title, peer, key in times))
    yield "legid against its own floor:"
    yield table(head, ((title, *(show(found["legid", n], n) for n in lengths)) for title, show in FLOOR.items()))
    if len(lengths) > 1:
        yield f"Exponent of growth from {min(lengths):,} to {max(lengths):,} samples: {exponent(found, lengths):.2f}."
    if {6000, 60000} <= set(lengths):
        by, typed = (found["legid", 60000][key] / found["legid", 6000][key] for key in ("seconds", TYPED))
        yield f"60,000 samples take {by:.1f} times what 6,000 take, as typed {typed:.1f} times."


BEYOND = """\
Residuals and Jacobian are the floor of a fit. Each step also sums the normal equations, eliminates the motion and
updates noise levels. The steps on an excerpt, the filters of the start and the test of excitation come on top. In short
records most of the time goes into calls, not arithmetic."""


def asked(found: Table) -> Iterator[str]:
    """What was asked of the fit, and what this run shows, as Markdown; of what was measured only."""
    rows: list[tuple[str, float, float, str, str]] = []
    own = {n: e for (peer, n), e in found.items() if peer == "legid" and "seconds" in e}
    for title, peer, n, least, theirs, ours in (
            ("faster than CasADi with IPOPT, 2,000 samples", "casadi", 2000, 30, "seconds", "seconds"),
            ("faster than its solve alone, 2,000 samples", "casadi", 2000, 3, "solve_s", "seconds"),
            ("faster than MuJoCo sysid at the record's rate, 5,000 samples", "mujoco", 5000, 50, "seconds", "seconds"),
            ("faster than MuJoCo sysid at its default step, 5,000 samples", "mujoco-2ms", 5000, 50, "seconds",
             "seconds"),
            ("as typed, 2,000 samples, against CasADi with IPOPT as a script", "casadi", 2000, 10, TYPED, TYPED),
            ("as typed, 2,000 samples, against MuJoCo sysid as a script", "mujoco", 2000, 5, TYPED, TYPED)):
        entry = found.get((peer, n), {})
        if "seconds" in entry and n in own:
            rows.append((title, entry[theirs] / own[n][ours], least, "at least", " times"))
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
    yield table(" | asked | measured | ", (
        f"{title} | {sense} {bound:g}{unit} | {value:.3g}{unit} | "
        + ("met" if (value >= bound if sense == "at least" else value <= bound) else "missed")
        for title, value, bound, sense, unit in rows))
    yield BEYOND
    if 5000 in own and "seconds" in found.get(("mujoco", 5000), {}):
        share = 1e6 * found["mujoco", 5000]["seconds"] / 50 / (5000 * own[5000]["iterations"])
        yield ("MuJoCo sysid fits eight parameters to a free run, but neither motion nor noise levels. A fiftieth of "
               f"its time is {share:.2f} us for each sample and step of the fit. Residual and Jacobian take "
               f"{1e6 * own[5000]['evaluation_s'] / 5000:.2f} us.")


COMPARED = """\
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
  numerically, as (51) says (`evidence/bench/paper.py`)."""


def page(samples: Sequence[int] = SAMPLES, limit: float = 100.0, peers: Sequence[str] = PEERS) -> Lines:
    before = os.getloadavg()[0]
    found = measure(samples, peers, limit)
    packages = ", ".join(f"{name} {version(name)}" for name in ("numba", "casadi", "mujoco"))
    yield from [
        "# Speed of the default fit",
        f"A leg with IMU and knee encoder, simulated by MuJoCo (seed {SEED}, {RATE_HZ:.0f} Hz); shorter "
        f"records are the beginning of the longest. Each peer ran alone in its own process, at most {limit:.0f} s "
        f"(legid, which fits several times, {REPEATED} times as long).",
        f"{packages}, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'not set')}. "
        f"Load average at the start {before:.1f}, at the end {os.getloadavg()[0]:.1f}. Other work on the machine slows "
        "everything down, though not everything alike."]
    yield from tables(found, samples, peers)
    yield "Asked, and measured in this run:"
    yield from asked(found)
    yield COMPARED


EVIDENCE = Evidence(
    "Speed of the default fit against CasADi with IPOPT and MuJoCo sysid", "make bench", "bench.md", 15,
    "30 times CasADi with IPOPT at 2,000 samples, 50 times MuJoCo sysid at 5,000",
    (r"(faster than CasADi with IPOPT, 2,000 samples) \|[^|]*\| (\S+ times)",
              r"(faster than MuJoCo sysid at the record's rate, 5,000 samples) \|[^|]*\| (\S+ times)"), r"seed (\d+)",
    resumes="no: all times are of one load")
main = program(page)
