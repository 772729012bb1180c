"""The dashboard for half an hour in a real browser: memory, what the recorder lost, how long an emergency stop takes.

    python -m evidence live-soak --minutes 30 --out docs/evidence/live.md
"""

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

from daq.recording import Plan, write_plan
from daq.runs import read_run
from drivers.mock import STEP_NS
from evidence.frame import Lines, program, table
from evidence.registry import Evidence
from experiments.emulation import ServedRig
from experiments.excite import random_multisine
from experiments.reports.run_info import lost_frames
from tests.support.live_browser import Browser, Live, open_page
from tests.support.paths import ROOT

WARM_UP_S = 60.0
LOOK_EVERY_S = 10.0
ALONE_S = 120.0
RIG_PRIORITY = 20
MIB = 2**20


def serve(folder: Path, line: Connection) -> None:
    """The emulated rig as a process of its own, ahead of all others: a rig of metal is not late either."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(RIG_PRIORITY))
    with ServedRig(folder) as rig:
        line.send(str(rig.rig_path))
        while (asked := line.recv()) is not None:
            with rig.mock.lock:
                t_ns, commanded, _ = rig.mock.firmware.record
            line.send(zero_after(t_ns, commanded, asked))


def zero_after(t_ns: Any, commanded: Any, from_ns: int) -> tuple[float, int | None]:
    """(torque commanded at `from_ns` [N m], time from when on it is zero for good [ns], None while it is not)."""
    at = max(int(np.searchsorted(t_ns, from_ns)) - 1, 0)
    driven = np.flatnonzero(commanded != 0.0)
    if not len(driven) or driven[-1] + 1 >= len(t_ns):
        return float(commanded[at]), None if len(driven) else from_ns
    return float(commanded[at]), int(t_ns[driven[-1]] + STEP_NS)


def served(rig: Path, folder: Path, name: str) -> Live:
    """The dashboard over one plan, with a folder of its own for the runs."""
    return Live("--rig", str(rig), "--plans", str(folder / name), "--out", str(folder / f"{name}-out"))


class Press(NamedTuple):
    """One emergency stop."""

    way: str
    before_nm: float
    """Torque commanded when it was pressed."""
    latency_ms: float
    """From just before the browser was told to press until the emulator's commanded torque was zero for good."""


def press_once(browser: Browser, line: Connection, rng: np.random.Generator, by_key: bool) -> Press:
    """Start, wait until the motor is driven, press at a random time, release."""
    browser.click("start")
    browser.phase("Recording")
    time.sleep(rng.uniform(2.2, 5.0))
    while True:
        pressed_ns = time.monotonic_ns()
        line.send(pressed_ns)
        before, _ = line.recv()
        if abs(before) > 0.05:
            break
        time.sleep(0.02)
    pressed_ns = time.monotonic_ns()
    if by_key:
        browser.key("Escape", "Escape", 27)
    else:
        browser.mouse("estop")
    browser.phase("EMERGENCY STOP")
    line.send(pressed_ns)
    before, zero_ns = line.recv()
    assert zero_ns is not None, "the torque is still commanded"
    browser.click("release")
    browser.phase("Idle")
    return Press("Esc" if by_key else "click", before, (zero_ns - pressed_ns) * 1e-6)


class Look(NamedTuple):
    """Memory at one time of the streaming."""

    at_s: float
    server_mib: float
    renderer_mib: float
    heap_mib: float
    load: float
    """Average of the machine's last minute: processes that run or wait."""


def look(at_s: float, server: psutil.Process, browser: Browser) -> Look:
    """Resident memory of the page's process and of the browser's renderer, and its JavaScript heap when collected."""
    browser.cdp("HeapProfiler.collectGarbage")
    metrics = {m["name"]: m["value"] for m in browser.cdp("Performance.getMetrics")["metrics"]}
    renderers = [p for p in psutil.Process(browser.driver.service.process.pid).children(recursive=True)
                 if "--type=renderer" in p.cmdline()]
    return Look(at_s, server.memory_info().rss / MIB, max(p.memory_info().rss for p in renderers) / MIB,
                metrics["JSHeapUsedSize"] / MIB, os.getloadavg()[0])


def stream(browser: Browser, live: Live, seconds: float) -> tuple[list[Look], float, float]:
    """Looks while a recording of that length runs, the server's share of a core, and how often the page was served."""
    browser.cdp("Performance.enable")
    browser.js("(window.shows = 0, legid.show = (f => s => { window.shows++; f(s); })(legid.show))")
    server = psutil.Process(live.child.pid)
    browser.click("start")
    browser.phase("Recording")
    began, looks = time.monotonic(), []
    cpu = sum(server.cpu_times()[:2])
    while browser.text("phase") in ("Opening devices", "Recording"):
        looks.append(look(time.monotonic() - began, server, browser))
        time.sleep(LOOK_EVERY_S)
        if looks[-1].at_s > seconds + 60.0:
            raise AssertionError("the recording does not end")
    if browser.text("phase") != "Finished":
        raise AssertionError(f"after {looks[-1].at_s:.0f} s: {browser.text('phase')}: {browser.text('words')}")
    took = time.monotonic() - began
    return looks, (sum(server.cpu_times()[:2]) - cpu) / took, browser.js("window.shows") / took


def growth(looks: list[Look], field: str) -> str:
    """First and last minute after the warm-up (means), largest value, and the slope of a straight line."""
    late = [one for one in looks if one.at_s >= WARM_UP_S] or looks
    values, times = np.array([getattr(one, field) for one in late]), np.array([one.at_s for one in late]) / 60.0
    slope = float(np.polyfit(times, values, 1)[0]) if len(values) > 2 else float("nan")
    return (f"{values[times <= times[0] + 1].mean():.1f} | {values[times >= times[-1] - 1].mean():.1f} | "
            f"{values.max():.1f} | {slope:+.3f}")


def recorded(path: Path) -> str:
    """What a recorder did and lost, in a line."""
    raw = read_run(path)
    telemetry, imu = raw.streams["/leg/telemetry"], raw.streams["/imu"]
    return (f"{imu.size} IMU samples, {int(imu['gap_before'].sum())} gaps; {telemetry.size} telemetry frames, "
            f"{lost_frames(telemetry)} lost; {raw.streams['/leg/command'].size} torque commands sent; the file is "
            f"{'whole' if raw.complete else 'CUT OFF'}")


def write_plans(folder: Path, minutes: float) -> None:
    """Ten seconds of excitation again and again: to press in, to record without a page, to stream."""
    once = random_multisine(5, 10.0, 0.7)
    for name, seconds in (("press", 60.0), ("alone", ALONE_S), ("soak", 60.0 * minutes)):
        count = round(seconds / 10.0)
        (folder / name).mkdir()
        write_plan(Plan(np.arange(count * len(once.time_s)) / 100.0, np.tile(once.torque_nm, count)),
                   folder / name / f"{name}.csv")


def page(minutes: float = 30.0, presses: int = 24, seed: int = 1) -> Lines:
    with tempfile.TemporaryDirectory(prefix="legid-soak-") as name:
        yield from _measured(Path(name), minutes, presses, seed)


def _measured(folder: Path, minutes: float, count: int, seed: int) -> Iterator[str]:
    here, there = multiprocessing.get_context("spawn").Pipe()
    rig = multiprocessing.get_context("spawn").Process(target=serve, args=(folder / "rig", there))
    rig.start()
    rig_path = Path(here.recv())
    write_plans(folder, minutes)
    try:
        with served(rig_path, folder, "press") as live, open_page(live) as browser:
            rng = np.random.default_rng(seed)
            presses = [press_once(browser, here, rng, k % 4 == 3) for k in range(count)]
            outgoing, complaints, asked = browser.outgoing(), browser.complaints(), len(browser.requests)
        subprocess.run([sys.executable, "-m", "legid.cli", "record", "--rig", rig_path, "--plan",
                        folder / "alone" / "alone.csv", "--out", folder / "alone.mcap"], cwd=ROOT, check=True,
                       stdout=subprocess.DEVNULL)
        with served(rig_path, folder, "soak") as live, open_page(live, network=False) as browser:
            looks, share, shows = stream(browser, live, minutes * 60.0)
            drops = browser.text("drops")
            complaints += browser.complaints()
    finally:
        here.send(None)
        rig.join(10.0)
    took = np.array([press.latency_ms for press in presses])
    keys = sum(press.way == "Esc" for press in presses)
    loads = [one.load for one in looks]
    yield from [
        f"# The dashboard over {minutes:g} minutes", "The machine was shared: the load average was "
        f"{np.mean(loads):.1f} on average and {max(loads):.1f} at most while the page streamed. Rig, "
        "recorder, dashboard and browser (Chromium, headless) are a process each. The rig is that of "
        "`legid emulate`: an LSM9DS1 at 476 Hz, a controller at 500 Hz.",
        f"## {len(presses)} emergency stops",
        f"Time runs from just before the browser is told to press ({len(presses) - keys} clicks, {keys} times Esc) "
        "until the emulator's commanded torque stays zero. The torque at "
        f"the press was {min(abs(p.before_nm) for p in presses):.2f} to {max(abs(p.before_nm) for p in presses):.2f} "
        f"N m. Median {np.median(took):.0f} ms, worst {took.max():.0f} ms; over 100 ms: {int((took > 100).sum())}.",
        f"The network meanwhile: {asked} requests, of which to another machine: {len(outgoing)}. Errors and warnings "
        f"on the console, here and while it streamed: {len(complaints)}.",
        *[f"- {line}" for line in [*sorted(set(outgoing)), *complaints][:20]],
        f"## {minutes:g} minutes of streaming",
        f"Memory in MiB, from {WARM_UP_S:g} s on, looked at every {LOOK_EVERY_S:g} s.",
        table(" | first minute | last minute | largest | slope per minute", (
            f"{what} | {growth(looks, field)}" for what, field in (
                ("the page's process (resident)", "server_mib"), ("the browser's renderer (resident)", "renderer_mib"),
                ("its JavaScript heap", "heap_mib")))),
        f"The page was refreshed {shows:.2f} times a second; the page's process took {share:.1%} of one core.",
        f"The recorder: {recorded(next((folder / 'soak-out').glob('*.mcap')))}. The page said: {drops}.",
        f"The same recorder for {ALONE_S:g} s just before, with no dashboard: {recorded(folder / 'alone.mcap')} "
        f"(of {ALONE_S * 100:.0f} in the plan)."]


EVIDENCE = Evidence(
    "The dashboard in a browser: memory, losses, emergency stops", "make live-soak", "live.md", 35,
    "every stop within 100 ms, no telemetry lost",
    (r"Median \d+ ms, worst \d+ ms; over 100 ms: \d+", r"telemetry frames, \d+ lost"),
    resumes="no: a soak is one recording")
main = program(page)
