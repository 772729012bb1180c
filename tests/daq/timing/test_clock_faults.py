"""The controller's clock steps, wraps, stands still or changes its rate: said while recording, by info and by runs."""

import re
from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from daq.runs import RawRun, read_run
from daq.timing import align, decode, find_clock_faults, recorded_rig
from experiments.reports import describe_mcap, list_runs
from experiments.workflows import fit_runs
from tests.support.clock_bench import KINDS, WHICH, strike
from tests.support.paths import FIXTURES

WRAP = "back 25.57 s, as a counter at 168 MHz wraps"
THIN = [(WRAP, "both"), ("forward 5 ms", "telemetry"), ("back 0.5 s", "probes"), ("2 % faster", "both"),
        ("1 % slower", "telemetry"), ("freeze for 50 ms, then on from there", "both")]


def angles(raw: RawRun) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and knee angles of the telemetry that is used."""
    channel = decode(raw, recorded_rig(raw)).channels[0]
    return channel.time_s, channel.columns["q2_rad"]


def said(raw: RawRun) -> tuple[list[str], list[str]]:
    """What the recording said, and what the file says."""
    return ([note.text for note in raw.events if note.kind == "clock"],
            [str(flag) for flag in decode(raw, recorded_rig(raw)).flags if flag.kind == "clock"])


@pytest.mark.parametrize("kind, which", [
    pytest.param(kind, which, marks=[] if (kind, which) in THIN else [pytest.mark.slow])
    for kind in KINDS for which in WHICH])
def test_a_fault_of_the_clock_is_said_everywhere(kind: str, which: str, tmp_path: Path) -> None:
    path, *_ = strike(kind, which, "driving", tmp_path)
    raw = read_run(path)
    events, flags = said(raw)
    assert events and len(flags) == 1
    (line,) = list_runs(path)
    assert line.faulty and any("clock" in flaw for flaw in line.flaws)
    assert "the controller's clock failed" in describe_mcap(raw)
    time_s, _ = angles(raw)
    arrived = raw.streams["/leg/telemetry"]["host_ns"]
    assert (np.diff(time_s) > 0).all() and time_s[0] > -0.1 and time_s[-1] < (arrived[-1] - arrived[0]) * 1e-9 + 0.01


def test_a_wrapped_counter_is_corrected(tmp_path: Path) -> None:
    """The times are those of a run whose counter does not wrap, to the clock's bound."""
    raw = read_run(strike(WRAP, "both", "driving", tmp_path)[0])
    _, (flag,) = said(raw)
    assert "as a 32-bit counter at 168 MHz does; corrected by the clock probes" in flag
    (sound := tmp_path / "sound").mkdir()
    other = read_run(strike(WRAP, "none", "driving", sound)[0])
    assert said(other) == ([], [])
    (t, q), (t0, q0) = angles(raw), angles(other)
    assert t.size == t0.size == raw.streams["/leg/telemetry"].size
    assert np.abs(t - t0).max() < 5e-4 and np.array_equal(q, q0)
    grid = align(raw, recorded_rig(raw))
    assert np.isfinite(grid["q2_rad"]).mean() > 0.99


def test_samples_that_contradict_the_probes_are_counted(tmp_path: Path) -> None:
    raw = read_run(strike("forward 5 ms", "telemetry", "driving", tmp_path)[0])
    _, (flag,) = said(raw)
    rows, used = raw.streams["/leg/telemetry"].size, angles(raw)[0].size
    assert f"{rows - used} of {rows} samples are set aside" in flag and 0.3 * rows < used < 0.7 * rows


@pytest.mark.parametrize("name", ["healthy", "gap", "noisy", "saturated-gyro", "clock-reset"])
def test_a_sound_clock_is_not_suspected(name: str) -> None:
    raw = read_run(FIXTURES / f"{name}.mcap")
    assert find_clock_faults(raw) == [] and said(raw)[1] == []


def test_a_fit_says_how_many_samples_it_used(tmp_path: Path) -> None:
    """Set aside for the clock, or lost in a gap: no fit is silent about them."""
    path, *_ = strike("forward 5 ms", "telemetry", "driving", tmp_path)
    rig = recorded_rig(read_run(path))
    fitted = fit_runs([align(read_run(path), rig)], rig).result
    assert re.search(r"\d+ of \d+ samples are set aside", " ".join(one.text for one in fitted.findings))
    gap = align(read_run(FIXTURES / "healthy.mcap"), rig)
    gap["q2_rad"][200:300] = np.nan
    found = fit_runs([gap], load_rig(FIXTURES / "rig.toml")).result
    assert f"uses {found.samples} of {len(gap)} samples" in " ".join(one.text for one in found.findings)
